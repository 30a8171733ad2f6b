"""Repeated turns and pulses: what spreads, and what cannot."""

from typing import Any

import pytest

from benchmarks.positioning import Options, measure
from cosim.model.params import STEERING


@pytest.fixture(scope="module")
def rows() -> dict[tuple[str, str, str], dict[str, Any]]:
    found = measure(Options(robots=4, omega=(1050.0,), pulses=(0.15,), angles=(25.0,), seed=1))
    return {(row["what"], row["closed"], row["start"]): row for row in found}


@pytest.mark.long
def test_noise_spreads_pulses_through_the_speed_control_only(rows):
    closed, open_loop = rows["pulse", "speed", "same"], rows["pulse", "none", "same"]
    assert closed["ahead_sd_um"][0] > 0.0 and closed["turned_sd_deg"][0] > 0.0
    # The voltage does not depend on the measured speed: robots that begin alike stay alike.
    assert open_loop["largest_um"] == pytest.approx(0.0, abs=1e-3)
    assert rows["pulse", "none", "any"]["largest_um"] > 1.0  # other motor angles, other strokes


def test_steering_turns_to_its_tolerance_from_any_motor_angle(rows):
    short_deg = 57.3 * STEERING.turned_rad
    for start in ("same", "any"):
        turn = rows["turn", "heading", start]
        assert 25.0 - short_deg - 1.0 < turn["turned_deg"] < 25.0
        low, high = turn["turned_sd_deg"][1:]
        assert low < turn["turned_sd_deg"][0] < high
        assert rows["turn", "speed", start]["time_s"] == turn["time_s"]
