"""The C generator of the page next to numpy's, bit for bit."""

import ctypes
import subprocess
from pathlib import Path

import numpy as np
import pytest

import agent.web
from fmus.compiler import compiler_command

SOURCE = Path(agent.web.__file__).with_name("c") / "random.c"
SEEDS = (0, 1, 2**31, 2**32 - 1, 2**32, 2**53 - 1)
KEYS = ((0,), (0, 0), (0, 1, 3), (0, 1, 2_000_000), (7, 1, 3_000_000))


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    out = tmp_path_factory.mktemp("c") / "random.so"
    subprocess.run(
        [*compiler_command(), "-O2", "-shared", "-fPIC", str(SOURCE), "-o", str(out)], check=True
    )
    return ctypes.CDLL(str(out))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("keys", KEYS)
def test_uniform_numbers_have_the_bits_of_numpy(library, seed, keys):
    state = np.zeros(6, dtype=np.uint64)
    aligned = ctypes.c_void_p(state.ctypes.data + -state.ctypes.data % 16)
    words, found = np.array(keys, dtype=np.uint32), np.empty(1000)
    library.seed_generator(
        aligned, ctypes.c_uint64(seed), words.ctypes.data_as(ctypes.c_void_p), len(keys)
    )
    for part in (found[:1], found[1:17], found[17:]):  # continued from call to call
        library.fill_uniforms(aligned, part.ctypes.data_as(ctypes.c_void_p), len(part))
    expected = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=keys)).random(1000)
    assert found.tobytes() == expected.tobytes()
