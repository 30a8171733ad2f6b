"""Machines by name: parameters that were published together, as files, and those of users."""
