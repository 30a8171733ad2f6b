"""The motor's own sine: read from the acceleration of motors whose weight alone moves them."""

import math

import numpy as np
import pytest

OK = 0
ERROR_OF_SINE = 3e-16  # as sine.h says it, up to 1e7 rad
ERROR_OF_LIBM = 1.2e-16


@pytest.fixture
def sine(instance):
    """The sine of an angle in C: -omega_dot of a turning motor with m g r = J and nothing else."""
    weight = dict.fromkeys("mgrJ", 1.0) | dict.fromkeys(("b", "c", "K_T", "V_s_max"), 0.0)
    motor = instance(3)
    assert motor.set(**weight, omega_start=1.0) == OK
    assert motor.enter_initialization() == OK

    def of(angle: float) -> float:
        assert motor.set(theta_start=angle) == OK
        return -motor.get("omega_dot")[0]

    return of


@pytest.mark.parametrize("range_rad", [1e-300, 1e-5, 1.0, 10.0, 1e3, 1e6, 1e7])
def test_it_is_the_sine_and_odd(sine, range_rad):
    angles = np.random.default_rng(2).uniform(0.0, range_rad, 3000).tolist()
    # Where it is 0, and where its cosine is.
    angles += [k * math.pi / 2 for k in range(1, 40) if k * math.pi / 2 <= range_rad]
    for angle in angles:
        value = sine(angle)
        assert value == -sine(-angle)
        assert abs(value - math.sin(angle)) <= min(ERROR_OF_SINE + ERROR_OF_LIBM, 1e-15 * angle)


def test_it_is_zero_at_zero(sine):
    assert sine(0.0) == sine(-0.0) == 0.0


@pytest.mark.parametrize("angle", [1e9, 1e12, 1e15])
def test_it_is_as_sure_of_large_angles_as_their_last_place_is(sine, angle):
    for k in range(1000):
        x = angle * (1.0 - k * 1e-4)
        assert abs(sine(x) - math.sin(x)) <= 0.5 * math.ulp(x) + ERROR_OF_SINE


@pytest.mark.parametrize("angle", [1.1e15, 1e16, 1e100, 1.7e308])
def test_it_is_bounded_where_an_angle_says_nothing(sine, angle):
    assert sine(angle) == sine(-angle) == 0.0
