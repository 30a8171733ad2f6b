"""Writes the firmware's sources, and compiles them for a microcontroller."""

import os
import re
import struct
import subprocess
from pathlib import Path

import msgspec

from cosim.base.storage import temporary_folder, write_whole
from fmus.compiler import SAME_BITS, BuildError, compiler_command

SOURCES = Path(__file__).with_name("c")
# What a robot calls; main.c and board.c are the program around it.
LIBRARY = ("arctangent.c", "navigation.c", "steering.c", "speed_loop.c")
PROGRAM = (*LIBRARY, "main.c", "board.c")
FLAGS = ("-std=c99", "-O2", "-g0", "-ffreestanding", SAME_BITS, "-Wall", "-Wextra")
# Doubles are computed by the compiler's runtime: the floating-point unit of a Cortex-M4 has floats.
MICROCONTROLLER = ("-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4")
# Numbers of the steering that the sources have.
STEERING = (
    "forward_speed_rad_s",
    "backward_speed_rad_s",
    "turn_speed_rad_s",
    "max_speed_rad_s",
    "dither_rad_s",
    "turned_rad",
    "turn_again_rad",
    "heading_gain_1_s",
    "max_difference_rad_s",
    "lookahead_m",
    "least_lookahead_m",
)
_FRAME = re.compile(r"stack frame size \((\d+)\)")
_ALLOCATED, _WRITABLE, _WITHOUT_BITS = 2, 1, 8  # of ELF sections


class FirmwareSize(msgspec.Struct, frozen=True):
    """Memory that a robot's firmware needs on a Cortex-M4, in bytes.

    Attributes:
        robot: which, from 1.
        flash: code, tables and the compiler's runtime.
        ram: variables.
        stack: at most, the frames of all functions together.
    """

    robot: int
    flash: int
    ram: int
    stack: int


def write_sources(folder: Path, constants: str) -> list[Path]:
    """Write all sources, each whole or not at all.

    Args:
        folder: that receives them; made if missing.
        constants: content of `constants.h`.
    """
    files = {path.name: path.read_text() for path in sorted(SOURCES.glob("*.[ch]"))}
    for name, content in (files | {"constants.h": constants}).items():
        write_whole(folder / name, content)
    return [folder / name for name in (*files, "constants.h")]


def measure(folder: Path, robot: int) -> FirmwareSize:
    """Compile and link a robot's program for a Cortex-M4 and see what it needs.

    Args:
        folder: with the sources.
        robot: which, from 1.

    Raises:
        BuildError: ziglang is missing, or it failed.
    """
    if "ziglang" not in compiler_command():
        raise BuildError("sizes on a Cortex-M4 need its compiler: install ziglang")
    command = [*compiler_command(), *MICROCONTROLLER, *FLAGS, "-Wframe-larger-than=1"]
    command += ["-ffunction-sections", "-Wl,--gc-sections", "-Wl,-e,main"]
    command += [f"-DROBOT={robot}", f"-I{folder}", *(str(folder / name) for name in PROGRAM)]
    with temporary_folder() as work:
        program = Path(work) / "firmware.elf"
        run = subprocess.run(
            [*command, "-o", str(program)],
            env=os.environ | {"ZIG_LOCAL_CACHE_DIR": work},  # an older cache suppresses messages
            capture_output=True,
            text=True,
            check=False,
        )
        if run.returncode:
            raise BuildError(f"the C compiler failed for the firmware: {run.stderr.strip()}")
        flash, ram = _sections(program.read_bytes())
    return FirmwareSize(robot, flash, ram, sum(map(int, _FRAME.findall(run.stderr))))


def _sections(program: bytes) -> tuple[int, int]:
    """Bytes of flash and of RAM that the sections of a 32-bit ELF file take."""
    (start,) = struct.unpack_from("<I", program, 0x20)
    size, count = struct.unpack_from("<HH", program, 0x2E)
    flash = ram = 0
    for k in range(count):
        _, kind, flags, _, _, length = struct.unpack_from("<6I", program, start + k * size)
        if flags & _ALLOCATED:
            flash += 0 if kind == _WITHOUT_BITS else length
            ram += length if flags & _WRITABLE else 0
    return flash, ram
