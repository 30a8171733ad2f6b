"""Calibration: trials of single robots, and the map from drive speeds to motor speeds."""
