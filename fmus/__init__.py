"""The motor FMU and what builds it: C kernel, FMI shims, variable table, builder."""
