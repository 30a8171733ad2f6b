"""The decision process of the paper, exactly: interpretations, kernels, evaluation, bounds."""
