"""`python -m agent.experiments`: the command `minirobots experiments`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("experiments", "agent.experiments")
