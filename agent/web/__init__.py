"""A page in which a policy's robots drive: the kernels compiled to WebAssembly, and its HTML."""
