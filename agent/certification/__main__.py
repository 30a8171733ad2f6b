"""`python -m agent.certification`: the command `minirobots certify`."""

from minirobots.runner import run_named

if __name__ == "__main__":
    run_named("certify", "agent.certification")
