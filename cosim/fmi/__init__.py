"""FMUs of any kind: archives, loading, units, and calls of their C functions from machine code."""
