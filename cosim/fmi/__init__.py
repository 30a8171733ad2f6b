"""FMUs: unpacking, loading, and calls of their C functions from machine code."""
