"""`python -m analysis.report`: the command `minirobots report`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("report", "analysis.report")
