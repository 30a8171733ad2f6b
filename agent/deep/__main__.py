"""`python -m agent.deep`: the command `minirobots deep`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("deep", "agent.deep")
