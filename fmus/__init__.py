"""The FMUs and what builds them: C kernels, FMI shims, variable tables, builder."""
