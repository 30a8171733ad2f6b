"""Compiles an episode's C, to WebAssembly for pages."""

from collections.abc import Sequence
from pathlib import Path

from agent.web.layout import render_header
from cosim.base.provenance import digest_of
from cosim.base.storage import cache_dir, cached, temporary_folder, write_whole
from fmus.compiler import SAME_BITS, BuildError, compiler_command, compiler_version, run_compiler
from fmus.models import ROOT
from fmus.variables import load_table
from fmus.variables import render_header as render_variables

C = Path(__file__).with_name("c")
FIRMWARE = ROOT.parent / "agent/firmware/c"
# Firmware first: constants.h of this folder stands for the generated one.
FOLDERS = (C, FIRMWARE, *(ROOT / name for name in ("mini_robot", "vibration_motor", "fmi")))
FLAGS = ("-std=c11", "-O3", "-g0", "-s", "-fno-math-errno", "-fvisibility=hidden", SAME_BITS,
         "-Wall", "-Wextra", "-Wno-unused-function", "-Wno-unused-const-variable",
         "-Wno-unused-parameter")  # fmt: skip
WASM = ("-target", "wasm32-wasi", "-mexec-model=reactor", "-Wl,--export-dynamic")
CARRIED = Path("agent/web/built/episode.wasm")  # in a wheel


def compile_wasm() -> bytes:
    """Return the WebAssembly module.

    Raises:
        BuildError: ziglang is missing, or it failed.
    """
    if "ziglang" not in compiler_command():
        raise BuildError(
            "a page's WebAssembly is compiled by ziglang, which is missing; "
            "install it: pip install ziglang"
        )
    with temporary_folder() as folder:
        out = Path(folder) / "episode.wasm"
        compile_episode(WASM, out)
        return out.read_bytes()


def cached_wasm() -> bytes:
    """Return the module that the wheel carries, or one that is compiled on first use.

    Raises:
        BuildError: see `compile_wasm`.
    """
    carried = ROOT.parent / CARRIED
    if carried.is_file():
        return carried.read_bytes()
    sources = {p.name: p.read_text() for folder in FOLDERS for p in sorted(folder.glob("*.[ch]"))}
    key = digest_of(sources, render_header(), _variables(), FLAGS, WASM, compiler_version())
    path = cache_dir("web") / f"{key}.wasm"
    return cached(path, Path.read_bytes, compile_wasm, lambda wasm, at: write_whole(at, wasm))


def _variables() -> str:
    return render_variables(load_table("VibrationMotors"), "")


def compile_episode(flags: Sequence[str], out: Path) -> None:
    """Compile an episode's C to the file `out`, with the compiler's `flags` for its platform.

    Raises:
        BuildError: no compiler was found, or it failed.
    """
    with temporary_folder() as folder:
        work = Path(folder)
        (work / "layout.h").write_text(render_header())
        (work / "variables.h").write_text(_variables())
        command = [*compiler_command(), *FLAGS, *flags, f"-I{work}"]
        command += [f"-I{folder}" for folder in FOLDERS]
        command += [str(C / "episode.c"), "-o", str(out.absolute())]
        run_compiler(command, work, "the page")
