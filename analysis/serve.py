"""`python -m analysis.serve`: the command `minirobots serve`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("serve", "analysis.serve")
