"""`python -m agent.process.bound`: the command `minirobots bound`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("bound", "agent.process.bound")
