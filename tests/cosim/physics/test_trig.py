"""Sine, cosine and arctangents against the library's."""

import math

import numpy as np
from scipy import stats

from cosim.base.jit import kernel
from cosim.physics.trig import angle_of, arctangent, normals, sine_cosine, sines_cosines


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


@kernel
def angles_of(y: np.ndarray, x: np.ndarray, out: np.ndarray) -> None:
    for i in range(len(x)):
        out[i, 0], out[i, 1] = arctangent(x[i]), angle_of(y[i], x[i])


def test_angles_are_the_librarys_but_for_the_last_bits():
    rng = np.random.default_rng(2)
    y, x = rng.normal(size=(2, 500_000)) * 10.0 ** rng.uniform(-12, 12, (2, 500_000))
    out = np.empty((len(x), 2))
    angles_of(y, x, out)
    alone, both = np.arctan(x), np.arctan2(y, x)
    assert (np.abs(out[:, 0] - alone) <= np.spacing(np.abs(alone))).all()
    assert (out[:, 0] == alone).mean() > 0.995
    assert (np.abs(out[:, 1] - both) <= 2.0 * np.spacing(np.abs(both))).all()


def test_angles_along_the_axes_are_exact():
    for y, x in ((0.0, 1.0), (0.0, -1.0), (1.0, 0.0), (-1.0, 0.0), (1.0, 1.0), (-1.0, 1.0)):
        assert angle_of(y, x) == math.atan2(y, x)
    for x in (0.0, 1.0, -1.0, math.inf, -math.inf, 1e300):
        assert arctangent(x) == math.atan(x)
    assert math.isnan(arctangent(math.nan))


def test_arrays_have_the_bits_of_single_angles():
    angles = np.random.default_rng(3).uniform(-9.0, 9.0, (3, 4))
    sines, cosines = sines_cosines(angles)
    found = zip(sines.ravel().tolist(), cosines.ravel().tolist(), strict=True)
    assert list(map(sine_cosine, angles.ravel().tolist())) == list(found)


def test_normal_numbers_are_normal_also_far_out():
    uniforms = np.random.default_rng(4).random((500_000, 2))
    uniforms[:4, 0] = 0.0, 2.0**-53, 1.0 - 2.0**-53, 0.5
    found, given = normals(uniforms), uniforms.copy()
    size = np.sqrt(-2.0 * np.log(1.0 - uniforms[:, 0]))
    angle = 2.0 * math.pi * uniforms[:, 1]
    expected = np.column_stack([size * np.cos(angle), size * np.sin(angle)])
    assert np.abs(found - expected).max() < 1e-14
    assert (uniforms == given).all()
    assert stats.kstest(found.ravel(), "norm").pvalue > 0.01
