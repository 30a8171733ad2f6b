"""`python -m agent.baselines`: the command `minirobots baselines`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("baselines", "agent.baselines")
