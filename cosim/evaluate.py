"""`python -m cosim.evaluate`: the command `minirobots evaluate`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("evaluate", "cosim.evaluate")
