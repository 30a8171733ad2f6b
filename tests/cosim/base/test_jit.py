"""Compiled kernels in the cache: found again, and compiled again where they are damaged."""

import numpy as np
import pytest
from numba.core.errors import TypingError

from cosim.base.jit import digest_of_sources, inlined, is_compiled, kernel
from cosim.base.storage import CACHE
from tests.alone import python


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


def test_every_change_of_the_sources_compiles_again(tmp_path):
    found = set()
    for name, text in (("a.py", "x = 1"), ("a.py", "x = 2"), ("b.py", "x = 2")):
        folder = tmp_path / f"{name}{text}"
        (folder / "cosim" / "deep").mkdir(parents=True)
        (folder / "cosim" / "deep" / name).write_text(text)
        (folder / "other.py").write_text(text)
        found.add(digest_of_sources(folder))
    assert len(found) == 3


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
