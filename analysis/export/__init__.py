"""Recordings for programs that know no Rerun: every signal with its unit and time."""
