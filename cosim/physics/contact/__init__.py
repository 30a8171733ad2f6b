"""Laws of contact between feet and floor, one per file."""
