"""Compiled kernels in the cache: found again, and compiled again where they are damaged."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from numba.core.errors import TypingError

from cosim.base.jit import (
    LAYERS,
    digest_of_sources,
    inlined,
    is_compiled,
    kernel,
)
from cosim.base.storage import CACHE
from tests.alone import python

ROOT = Path(__file__).parents[3]


def halved(value):
    return 0.5 * value


def test_what_is_in_the_cache_is_known_without_compiling(tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE, str(tmp_path))
    new = kernel(halved)
    assert not is_compiled(new)
    new(3.0)
    assert is_compiled(new)
    assert is_compiled(kernel(halved))  # another process would find it


def test_damaged_kernels_are_compiled_again(tmp_path, monkeypatch, caplog):
    monkeypatch.setenv(CACHE, str(tmp_path))

    def run():
        """Value, and whether its code was found; nothing of the kernel is in memory yet."""
        new = kernel(halved)
        return new(3.0), sum(new.stats.cache_hits.values())  # pyright: ignore

    assert [run(), run()] == [(1.5, 0), (1.5, 1)]
    for ending in ("nbi", "nbc"):
        (file,) = tmp_path.rglob(f"*.halved*.{ending}")
        content = bytearray(file.read_bytes())
        content[len(content) // 2] ^= 1
        file.write_bytes(content)
        assert not caplog.messages
        assert run() == (1.5, 0)
        assert {*caplog.messages} == {f"{file} is damaged: compiling it again"}
        caplog.clear()
        assert run() == (1.5, 1)


def test_kernels_depend_on_their_layer_and_those_below(tmp_path):
    for layer in LAYERS:
        (tmp_path / layer / "deep").mkdir(parents=True)
        (tmp_path / layer / "deep" / "a.py").write_text("x = 1")

    def digests():
        digest_of_sources.cache_clear()
        return [digest_of_sources(tmp_path, layer) for layer in [*LAYERS, "docs/examples"]]

    before = digests()
    for edited, layer in enumerate(LAYERS):
        (tmp_path / layer / "deep" / "a.py").write_text("x = 2")
        after = digests()
        assert [a != b for a, b in zip(after, before, strict=True)] == [
            number >= edited for number in range(len(before))
        ]
        before = after
    (tmp_path / LAYERS[0] / "b.py").write_text("x = 2")
    assert not set(digests()) & set(before)


def test_layers_are_those_of_the_import_contracts():
    linter = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]
    whole, agent, *_ = (contract.get("layers") for contract in linter["contracts"])
    rows = [{name.strip() for name in row.split("|")} for row in [*reversed(whole)]]
    order = [{name.replace(".", "/") for name in row} for row in rows]
    order += [{name.replace(".", "/")} for name in reversed(agent)]
    for lower, layer in enumerate(LAYERS):
        for higher in LAYERS[lower + 1 :]:
            places = [
                next(n for n, row in enumerate(order) if any(r.startswith(name) for r in row))
                for name in (layer, higher)
            ]
            assert places[0] <= places[1], (layer, higher)
    for folder in (*ROOT.glob("cosim/*/"), *ROOT.glob("agent/*/")):
        if any("base.jit import" in file.read_text("utf-8") for file in folder.rglob("*.py")):
            assert folder.relative_to(ROOT).as_posix() in LAYERS


def itself(array):
    return array, 1.0


def calling(inner):
    def outer(array):
        return inner(array)

    return outer


def without_first(array):
    return array[1:]


def made(array):
    return np.zeros(2)[0] + array[0]


@pytest.mark.parametrize(
    ("inner", "why"), [(itself, "itself returns an array"), (made, "np.empty|np.zeros|empty")]
)
def test_inlined_functions_count_no_references(tmp_path, monkeypatch, inner, why):
    """One more count fewer than there are references, and memory would be freed that is in use."""
    monkeypatch.setenv(CACHE, str(tmp_path))
    with pytest.raises((TypeError, TypingError), match=why):
        kernel(calling(inlined(inner)))(np.ones(2))


def test_inlined_functions_take_no_arrays_of_kernels(tmp_path, monkeypatch):
    """Nor does a kernel that they call first lose its counts."""
    monkeypatch.setenv(CACHE, str(tmp_path))
    rest = kernel(without_first)

    def first(array):
        return rest(array)[0]

    with pytest.raises(TypeError, match="without_first returns an array"):
        kernel(calling(inlined(first)))(np.ones(2))
    assert rest(np.array([1.0, 2.0])).tolist() == [2.0]


# Ctrl-C while LLVM tells numba that it has made machine code.
INTERRUPTED = """
import os, signal, sys
from numba.core.codegen import JITCodeLibrary
usual = JITCodeLibrary._object_compiled_hook
def interrupted(module, content):
    os.kill(os.getpid(), signal.SIGINT)
    usual(module, content)
JITCodeLibrary._object_compiled_hook = interrupted
from cosim.base.jit import kernel
def halved(value):
    return 0.5 * value
try:
    kernel(halved)(3.0)
except KeyboardInterrupt:
    sys.exit(130)
"""


def test_an_interrupt_within_the_compiler_is_not_lost(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    ended = python(script)
    assert (ended.returncode, ended.stderr) == (130, "")


# SIGTERM while LLVM tells numba that it has made machine code, and again as numba unlocks.
AGAIN = """
import os, signal, sys, threading
from numba.core import compiler_lock
from numba.core.codegen import JITCodeLibrary
from cosim.base.errors import run_command
usual, release = JITCodeLibrary._object_compiled_hook, compiler_lock._CompilerLock.release
def again(lock):
    os.kill(os.getpid(), signal.SIGTERM)
    release(lock)
def interrupted(module, content):
    os.kill(os.getpid(), signal.SIGTERM)
    compiler_lock._CompilerLock.release = again
    usual(module, content)
JITCodeLibrary._object_compiled_hook = interrupted
from cosim.base.jit import kernel
def halved(value):
    return 0.5 * value
def main():
    try:
        kernel(halved)(3.0)
    finally:
        free = []
        lock = compiler_lock.global_compiler_lock._lock
        thread = threading.Thread(target=lambda: free.append(lock.acquire(timeout=1.0)))
        thread.start()
        thread.join()
        print(free)
run_command(main)
"""


def test_signals_within_the_compiler_leave_it_unlocked(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(AGAIN)
    done = python(script)
    assert (done.returncode, done.stdout, done.stderr) == (143, "[True]\n", "interrupted\n")
