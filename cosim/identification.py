"""`python -m cosim.identification`: the command `minirobots identify-robot`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("identify-robot", "cosim.identification")
