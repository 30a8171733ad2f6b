"""`python -m cosim.design`: the command `minirobots design`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("design", "cosim.design")
