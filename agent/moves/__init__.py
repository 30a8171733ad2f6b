"""Moves observed in the co-simulation, and the process made of them."""
