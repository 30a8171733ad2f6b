"""`python -m cosim.robustness`: the command `minirobots robustness`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("robustness", "cosim.robustness")
