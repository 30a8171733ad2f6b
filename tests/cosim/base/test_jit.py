"""Compiled kernels in the cache: found again, and compiled again where they are damaged."""

import gc
import importlib
import subprocess
import sys
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba.core.errors import TypingError
from numba.core.registry import cpu_target

from cosim.base import kernel_files
from cosim.base.errors import FileError
from cosim.base.jit import inlined, is_compiled, kernel
from cosim.base.kernel_files import kernel_digest


def halved(value):
    return 0.5 * value


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_what_is_in_the_cache_is_known_without_compiling(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_files, "FOLDER", tmp_path)
    new = kernel(halved)
    assert not is_compiled(new)
    new(3.0)
    assert is_compiled(new)
    assert is_compiled(kernel(halved))  # another process would find it


def test_garbage_is_collected_again_after_compiling(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_files, "FOLDER", tmp_path)
    kernel(halved)(3.0)
    assert gc.isenabled()


def test_damaged_kernels_are_compiled_again(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(kernel_files, "FOLDER", tmp_path)

    def run():
        """Value, and whether its code was found; nothing of the kernel is in memory yet."""
        new = kernel(halved)
        return new(3.0), sum(new.stats.cache_hits.values())  # pyright: ignore

    assert [run(), run()] == [(1.5, 0), (1.5, 1)]
    for ending in ("nbi", "nbc"):
        (file,) = tmp_path.rglob(f"*.halved*.{ending}")
        flip(file)
        assert not caplog.messages
        assert run() == (1.5, 0)
        assert {*caplog.messages} == {f"{file} is damaged: compiling it again"}
        caplog.clear()
        assert run() == (1.5, 1)
    file.unlink()
    file.mkdir()
    with pytest.raises(FileError, match=f"{file}: a folder is where"):
        run()


class Former(NamedTuple):
    value: float


class Present(NamedTuple):
    value: float


def doubled(record):
    return 2.0 * record.value


def test_kernels_of_a_renamed_record_are_compiled_again(tmp_path, monkeypatch):
    """The code of a kernel does not say what the class of an argument is called."""
    monkeypatch.setattr(kernel_files, "FOLDER", tmp_path)
    assert kernel(doubled)(Former(1.5)) == 3.0
    monkeypatch.delattr(sys.modules[__name__], "Former")
    assert [kernel(doubled)(Present(1.5)) for _ in range(2)] == [3.0, 3.0]


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
    monkeypatch.setattr(kernel_files, "FOLDER", tmp_path)
    with pytest.raises((TypeError, TypingError), match=why):
        kernel(calling(inlined(inner)))(np.ones(2))


def test_inlined_functions_take_no_arrays_of_kernels(tmp_path, monkeypatch):
    """Nor does a kernel that they call first lose its counts."""
    monkeypatch.setattr(kernel_files, "FOLDER", tmp_path)
    rest = kernel(without_first)

    def first(array):
        return rest(array)[0]

    with pytest.raises(TypeError, match="without_first returns an array"):
        kernel(calling(inlined(first)))(np.ones(2))
    assert rest(np.array([1.0, 2.0])).tolist() == [2.0]


def half_of_first(array):
    return 0.5 * array[0]


def test_inlined_functions_have_no_machine_code_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_files, "FOLDER", tmp_path)
    outer = kernel(calling(inlined(half_of_first)))
    assert outer(np.array([3.0])) == 1.5
    context: Any = cpu_target.target_context
    symbols = context.codegen()._engine._defined_symbols
    assert any("calling" in symbol for symbol in symbols)
    assert not any("half_of_first" in symbol and "Env" not in symbol for symbol in symbols)


KERNEL = """
from typing import Any, NamedTuple
import numpy as np
from cosim.base.jit import inlined, is_compiled, kernel

GAIN = 2.0


class Motor(NamedTuple):
    '''Constants.'''

    torque: float
    friction: float = 0.5


@inlined
def loss(motor, speed):
    '''Friction.'''
    if speed < 0.0:
        raise ValueError
    return motor.friction * speed


@kernel
def power(speed):
    '''Power.'''
    return GAIN * speed - loss(Motor(1.0), speed) + np.sin(speed)  # W
"""


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("# W", "# watts", True),
        ("Power.", "Return the power.", True),
        ("Friction.", "Return the loss.", True),
        ("Constants.", "Constants of a motor.", True),
        ("import numpy", "\n\nimport math\nimport numpy", True),
        ("GAIN = 2.0", "GAIN = 2.5", False),
        ("friction: float = 0.5", "friction: float = 0.6", False),
        ("torque: float\n", "torque: float\n    mass: float = 1.0\n", False),
        ("motor.friction * speed", "motor.friction / speed", False),
        ("np.sin", "np.cos", False),
    ],
)
def test_a_kernel_is_known_by_what_it_does(tmp_path, monkeypatch, old, new, same):
    def digest(text):
        (tmp_path / "motor_kernel.py").write_text(text)
        monkeypatch.delitem(sys.modules, "motor_kernel", raising=False)
        importlib.invalidate_caches()
        return kernel_digest(importlib.import_module("motor_kernel").power.py_func)

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    assert old in KERNEL
    assert (digest(KERNEL) == digest(KERNEL.replace(old, new))) == same


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
    command = [sys.executable, str(script)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (130, "")
