"""`python -m analysis.reproduce`: the command `minirobots reproduce`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("reproduce")
