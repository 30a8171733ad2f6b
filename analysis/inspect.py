"""`python -m analysis.inspect`: the command `minirobots inspect`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("inspect", "analysis.inspect")
