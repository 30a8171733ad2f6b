"""Q-learning: from a configuration to a policy in a file."""
