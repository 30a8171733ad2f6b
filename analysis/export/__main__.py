"""`python -m analysis.export`: the command `minirobots export`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("export", "analysis.export")
