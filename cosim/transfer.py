"""`python -m cosim.transfer`: the command `minirobots transfer`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("transfer", "cosim.transfer")
