"""The simulation held against published machines: what they did, and what ours do."""
