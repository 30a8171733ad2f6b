"""The FMUs and what builds them: C kernels, FMI shims, variable tables, builder."""

from cosim.base import errors as _errors  # noqa: F401 - from now on Ctrl-C ends a command quietly
