"""`python -m analysis.screenshot`: the command `minirobots screenshot`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("screenshot", "analysis.screenshot")
