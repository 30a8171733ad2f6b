"""`python -m analysis.figures`: the command `minirobots figures`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("figures", "analysis.figures")
