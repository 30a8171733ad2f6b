"""`python -m cosim.evaluate`: the command of `agent.evaluation.dynamics`."""

from agent.evaluation.dynamics import main
from cosim.base.errors import run_command

if __name__ == "__main__":
    run_command(main)
