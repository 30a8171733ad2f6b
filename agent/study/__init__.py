"""Studies: many episodes of policies, kept as they end, and the tables that are made of them.

`store` keeps rows on disk, `episodes` says which episodes make a row of a table. `evaluate`
and `transfer` are studies of this project, `user` is one of your own.
"""
