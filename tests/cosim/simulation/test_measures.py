"""Measures along an episode, against what can be computed by hand or at every tick."""

import math

import numpy as np
import pytest

from cosim.coupling.signals import Samples, new_samples
from cosim.fmi.motor import Motor, MotorFmu
from cosim.model.params import SPEED_NOISE, STEERING, TIMING
from cosim.simulation.measures import PATH_SAMPLING_S, Measures, _add

PERIOD_S = 1e-3


def measures_from(positions: np.ndarray) -> Measures:
    return Measures(positions, np.zeros(len(positions)), PERIOD_S)


def samples_of(positions: np.ndarray, voltage: float = 0.0, current: float = 0.0) -> Samples:
    samples = new_samples(len(positions), positions.shape[1])
    samples.position[:, :, :2] = positions
    samples.voltage[:] = voltage
    samples.current[:] = current
    return samples


def circles(radii: tuple[float, ...], periods: int) -> np.ndarray:
    """One turn of each robot around its own centre, centres 20 cm apart on a line."""
    angle = 2.0 * np.pi * np.arange(1, periods + 1) / periods
    r, k = np.array(radii), np.arange(len(radii))
    x, y = 0.2 * k + r * np.cos(angle)[:, None], r * np.sin(angle)[:, None]
    return np.stack([x, y], axis=2)


def test_path_length_of_a_circle():
    positions = circles((0.05, 0.02), 10_000)
    measures = measures_from(positions[-1])
    for part in np.split(positions, 5):
        measures.add(samples_of(part))
    chord = 2.0 * np.sin(np.pi * PATH_SAMPLING_S / 10.0)
    assert measures.path_length_m == pytest.approx([0.05 * 100 * chord, 0.02 * 100 * chord])


@pytest.mark.parametrize("periods", [1, 30, 100, 150, 2000])
def test_path_length_does_not_depend_on_the_rl_step(periods):
    """Also where RL steps are shorter than the time between two points of the path."""
    positions = circles((0.05,), 6000)
    whole, parts = (measures_from(positions[-1]) for _ in range(2))
    whole.add(samples_of(positions))
    for first in range(0, len(positions), periods):
        parts.add(samples_of(positions[first : first + periods]))
    assert whole.path_length_m[0] > 0.3
    assert parts.path_length_m.tolist() == whole.path_length_m.tolist()


def test_vibration_is_no_path():
    still = np.zeros((10_000, 1, 2))
    shaking = (
        still + 1e-4 * np.sin(2.0 * np.pi * 150.0 * PERIOD_S * np.arange(10_000))[:, None, None]
    )
    measures = measures_from(still[0])
    measures.add(samples_of(shaking))
    assert measures.path_length_m[0] < 1e-3
    assert np.abs(np.diff(shaking[:, 0, 0])).sum() > 0.5


def test_rotation_counts_both_ways_and_beyond_a_turn():
    """400° one way and 100° back, in steps below half a turn, however RL steps cut them."""
    degrees = [np.linspace(0.0, 400.0, 4001)[1:], np.linspace(400.0, 300.0, 1001)[1:]]
    half = np.deg2rad(np.concatenate(degrees)) / 2
    samples = samples_of(np.zeros((5000, 1, 2)))
    samples.quaternion[:, 0, 0], samples.quaternion[:, 0, 3] = np.cos(half), np.sin(half)
    measures = measures_from(np.zeros((1, 2)))
    for part in np.split(np.arange(5000), 8):
        measures.add(Samples(*(signal[part] for signal in samples)))
    assert np.rad2deg(measures.rotation_rad) == pytest.approx([500.0])


def test_smallest_distance_of_any_pair_and_of_the_start():
    positions = circles((0.03, 0.0, 0.01), 1000)
    measures = measures_from(positions[-1])
    measures.add(samples_of(positions))
    assert measures.min_distance_m == pytest.approx(0.17)
    near = measures_from(np.array([[0.0, 0.0], [0.06, 0.08]]))
    assert near.min_distance_m == pytest.approx(0.1)
    near.add(samples_of(positions[:, :2]))
    assert near.min_distance_m == pytest.approx(0.1)
    assert measures_from(np.zeros((1, 2))).min_distance_m == float("inf")


def test_energy_is_what_is_drawn():
    rest = np.zeros((2000, 1, 2))
    measures = measures_from(rest[0])
    measures.add(samples_of(rest, voltage=-2.0, current=-0.1))
    measures.add(samples_of(rest, voltage=0.5, current=-0.01))
    # two motors, 2 s each
    assert measures.energy_j == pytest.approx([2 * 2.0 * 0.2])
    assert measures.regenerated_j == pytest.approx([2 * 2.0 * 0.005])


def test_contact_time_counts_shares_of_periods():
    samples = samples_of(np.zeros((10, 2, 2)))
    samples.touching_share[3:5] = 1.0
    samples.touching_share[5] = 0.25
    measures = measures_from(np.zeros((2, 2)))
    measures.add(samples)
    assert measures.contact_time_s == pytest.approx(2.25e-3)


def test_neither_layout_nor_neighbours_decide_a_bit():
    """Slices of a batch give what arrays of their own give, in the kernel compiled for those."""
    rng = np.random.default_rng(0)
    shapes = [signal.shape for signal in new_samples(300, 2)]
    batch = Samples(*(rng.standard_normal((*shape, 5)) for shape in shapes))
    for lane in range(5):
        sliced = Samples(*(signal[..., lane] for signal in batch))
        found = []
        for samples in (Samples(*(signal.copy() for signal in sliced)), sliced):
            measures = measures_from(samples.position[0, :, :2])
            measures.add(samples)
            versions = len(_add.signatures)  # pyright: ignore[reportFunctionMemberAccess]
            found.append([versions, *(np.asarray(v).tobytes() for v in vars(measures).values())])
        assert found[0] == found[1]


def test_energy_at_the_control_period_is_nearly_that_of_every_tick(motor_fmu):
    """A real motor under noise: the ends of control periods miss some per cent, never add any."""
    motor = Motor(MotorFmu(motor_fmu), "m")
    dt, ticks = TIMING.dt_s, round(TIMING.control_period_s / TIMING.dt_s)
    noise = np.random.default_rng(0).uniform(-1.0, 1.0, 300)
    noise *= SPEED_NOISE.relative_amplitude * STEERING.forward_speed_rad_s
    samples, at_ticks = new_samples(len(noise), 1), 0.0
    for period, value in enumerate(noise):
        tick = period * ticks
        motor.set(motor.fmu.inputs, np.array([STEERING.forward_speed_rad_s, value, 0.0]))
        for k in range(ticks):
            motor.step((tick + k) * dt, dt)
            voltage, current, *_ = motor.get(motor.fmu.electrical)
            at_ticks += max(voltage * current, 0.0) * dt
            # the last tick of the period stays
            samples.voltage[period, 0, 0], samples.current[period, 0, 0] = voltage, current
    motor.close()
    measures = measures_from(np.zeros((1, 2)))
    measures.add(samples)
    assert 0.94 * at_ticks < measures.energy_j[0] < at_ticks
    assert measures.regenerated_j[0] < 0.01 * measures.energy_j[0]


def test_robots_above_each_other_are_as_near_as_those_beside_each_other():
    """Pairs are left out by boxes around their paths; each way has to be looked at."""
    places = np.array([[1.0, 0.0], [1.1, 0.0], [0.0, 0.3], [0.0, 0.36], [0.5, 0.9], [0.55, 0.9]])
    for turned in (places, places[:, ::-1], places[::-1], -places):
        measures = measures_from(turned + 9.0 * np.arange(6)[:, None])  # far apart at the start
        measures.add(samples_of(np.tile(turned, (100, 1, 1))))
        assert measures.min_distance_m == pytest.approx(0.05)
        measures = measures_from(turned[:4] + 9.0 * np.arange(4)[:, None])
        measures.add(samples_of(np.tile(turned[:4], (100, 1, 1))))
        least = min(math.dist(a, b) for k, a in enumerate(turned[:4]) for b in turned[:k])
        assert measures.min_distance_m == pytest.approx(least)
