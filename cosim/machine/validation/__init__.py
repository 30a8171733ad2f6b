"""The simulation compared with published machines."""
