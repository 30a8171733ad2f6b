"""`python -m cosim.transfer`: the command of `agent.evaluation.transfer`."""

from agent.evaluation.transfer import main
from cosim.base.errors import run_command

if __name__ == "__main__":
    run_command(main)
