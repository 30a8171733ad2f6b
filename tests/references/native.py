"""C of the firmware as shared libraries of this machine."""

from collections.abc import Sequence
from pathlib import Path

from agent.firmware.build import FLAGS
from fmus.compiler import TARGETS, compiler_command, host_target, run_compiler


def _flags() -> list[str]:
    zig = "ziglang" in compiler_command()
    return [*(("-target", TARGETS[host_target()].triple) if zig else ()), "-shared", "-fPIC"]


def compile_firmware(folder: Path, out: Path, sources: Sequence[Path], robot: int = 1) -> None:
    """Write the functions of some of the firmware's sources for a robot, counted from 1."""
    command = [*compiler_command(), *_flags(), *FLAGS, f"-DROBOT={robot}", f"-I{folder}"]
    run_compiler([*command, *map(str, sources), "-o", str(out)], folder, "the firmware")
