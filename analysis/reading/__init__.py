"""Recordings and result files as arrays."""
