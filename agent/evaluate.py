"""`python -m agent.evaluate`: the command of `agent.evaluation.grid`."""

from agent.evaluation.grid import main
from cosim.base.errors import run_command

if __name__ == "__main__":
    run_command(main)
