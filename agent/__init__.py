"""Learning to navigate: decision process, Q-learning kernels, policies, evaluation."""
