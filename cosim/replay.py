"""`python -m cosim.replay`: the command `minirobots replay`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("replay", "cosim.replay")
