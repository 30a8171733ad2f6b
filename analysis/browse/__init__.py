"""Many recordings as a table in the Rerun viewer."""
