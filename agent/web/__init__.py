"""A page that plays episodes in a browser by the same kernels."""
