"""`python -m analysis.browse`: the command `minirobots browse`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("browse", "analysis.browse")
