"""`python -m cosim.run`: the command `minirobots run`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("run")
