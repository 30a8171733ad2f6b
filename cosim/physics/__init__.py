"""Rigid bodies, feet and contacts as kernels; knows no FMU."""
