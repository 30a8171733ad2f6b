"""`python -m cosim.calibrate`: the command `minirobots calibrate`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("calibrate", "cosim.calibrate")
