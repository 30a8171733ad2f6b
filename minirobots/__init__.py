"""Vibration-driven mini-robots that learn to navigate: everything under one name."""
