"""Recordings of episodes for the Rerun viewer, written and read."""
