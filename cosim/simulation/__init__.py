"""Episodes of RL steps on the master, many together: their options, tasks and results."""
