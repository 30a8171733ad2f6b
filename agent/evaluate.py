"""`python -m agent.evaluate`: the command `minirobots evaluate-grid`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("evaluate-grid", "agent.evaluate")
