"""Episodes of RL steps on the master, many together: what is seen, permitted and measured."""
