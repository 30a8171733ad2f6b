"""`python -m analysis.motor_loop`: the command `minirobots motor-loop`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("motor-loop", "analysis.motor_loop")
