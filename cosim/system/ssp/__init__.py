"""Systems read from files of SSP 1.0 and 2.0."""
