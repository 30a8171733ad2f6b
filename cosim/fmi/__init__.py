"""Motor FMUs: unpacked, checked and run with fmpy, and called from machine code."""
