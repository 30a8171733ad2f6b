"""Measure what policies achieve in the co-simulation."""
