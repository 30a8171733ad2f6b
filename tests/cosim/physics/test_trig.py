"""Sine and cosine against the library's."""

import numpy as np

from cosim.base.jit import kernel
from cosim.physics.trig import sine_cosine


@kernel
def both(angles: np.ndarray, out: np.ndarray) -> None:
    for i in range(len(angles)):
        out[i, 0], out[i, 1] = sine_cosine(angles[i])


def test_agrees_with_the_library_to_rounding():
    rng = np.random.default_rng(0)
    for span in (1.0, 1e3, 1e6):
        angles = rng.uniform(-span, span, 200_000)
        out = np.empty((len(angles), 2))
        both(angles, out)
        assert np.abs(out - np.stack([np.sin(angles), np.cos(angles)], axis=1)).max() < 2.3e-16


def test_is_exactly_odd_and_even():
    """Symmetric motors must push with exactly symmetric forces."""
    angles = np.random.default_rng(1).uniform(0.0, 1e4, 100_000)
    plus, minus = np.empty((len(angles), 2)), np.empty((len(angles), 2))
    both(angles, plus)
    both(-angles, minus)
    assert np.array_equal(plus[:, 0], -minus[:, 0])
    assert np.array_equal(plus[:, 1], minus[:, 1])
