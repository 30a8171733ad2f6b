"""`python -m cosim.platform`: the command `minirobots platform`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("platform", "cosim.platform")
