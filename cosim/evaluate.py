"""`python -m cosim.evaluate`: the command of `agent.evaluation.evaluate`."""

from agent.evaluation.evaluate import main
from cosim.base.errors import run_command

if __name__ == "__main__":
    run_command(main)
