"""`python -m agent.firmware`: the command `minirobots firmware`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("firmware", "agent.firmware")
