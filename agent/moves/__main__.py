"""`python -m agent.moves`: the command of `agent.moves.observe`."""

from agent.moves.observe import main
from cosim.base.errors import run_command

if __name__ == "__main__":
    run_command(main)
