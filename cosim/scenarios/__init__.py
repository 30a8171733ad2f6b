"""Boards of cells with targets and starts: those built in, and files."""
