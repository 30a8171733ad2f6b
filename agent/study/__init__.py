"""Studies: many episodes of policies, kept as they end, and the tables that are made of them."""
