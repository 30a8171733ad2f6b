"""The decision process of the paper, exactly: readings, kernels, evaluation, bounds."""
