"""`python -m analysis.report`: the command of `analysis.report.page`."""

from analysis.report.page import main
from cosim.base.errors import run_command

run_command(main)
