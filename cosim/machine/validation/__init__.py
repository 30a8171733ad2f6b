"""The simulation compared with published machines: what they did, and what is simulated."""
