"""Recordings for programs without Rerun: every signal with its unit and time."""
