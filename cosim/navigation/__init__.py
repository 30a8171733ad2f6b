"""Episodes of RL steps on top of the master: what is seen, permitted and measured."""
