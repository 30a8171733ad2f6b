"""`python -m cosim.system`: the command `minirobots system`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("system", "cosim.system")
