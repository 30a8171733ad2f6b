"""What policies achieve in the co-simulation."""
