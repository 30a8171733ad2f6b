"""The page with figures, tables and recordings."""
