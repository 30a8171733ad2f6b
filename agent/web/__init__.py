"""A page that plays episodes in a browser: the co-simulation in C, compiled to WebAssembly."""
