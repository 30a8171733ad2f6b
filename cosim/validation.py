"""`python -m cosim.validation`: the command `minirobots validate`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("validate", "cosim.validation")
