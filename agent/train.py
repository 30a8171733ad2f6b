"""`python -m agent.train`: the command of `agent.experiments.training`."""

from agent.experiments.training import main
from cosim.base.errors import run_command

if __name__ == "__main__":
    run_command(main)
