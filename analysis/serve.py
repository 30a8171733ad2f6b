"""`python -m analysis.serve`: the command of `analysis.report.server`."""

from analysis.report.server import main
from cosim.base.errors import run_command

if __name__ == "__main__":
    run_command(main)
