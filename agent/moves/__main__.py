"""`python -m agent.moves`: the command `minirobots moves`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("moves", "agent.moves")
