"""Rigid bodies, feet and contacts as kernels, without FMUs."""
