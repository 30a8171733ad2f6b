"""`python -m analysis.figures`: the command of `analysis.figures.draw`."""

from analysis.figures.draw import main
from cosim.base.errors import run_command

run_command(main)
