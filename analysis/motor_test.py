"""`python -m analysis.motor_test`: the command `minirobots motor-test`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("motor-test", "analysis.motor_test")
