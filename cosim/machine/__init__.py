"""Machines: the closed-form platform, parameters from tracks, and published measurements."""
