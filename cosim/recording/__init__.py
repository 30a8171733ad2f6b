"""Recordings of episodes for the Rerun viewer."""
