"""Domain randomisation: worlds within their ranges, and walks that each have their own."""

from dataclasses import replace

import numpy as np

from agent.moves import observe
from agent.moves.worlds import RANGES, draw_world
from cosim.model.config import CoSimConfig
from cosim.model.params import TIMING
from fmus.build import cached_fmu

SIDE, REACH = 400, 14


def test_worlds_are_within_their_ranges():
    rng = np.random.default_rng(0)
    worlds = [draw_world(RANGES, SIDE, REACH, rng) for _ in range(200)]
    for name in ("mu", "motor_spread", "restitution", "floor_tilt_deg", "payload_g"):
        low, high = getattr(RANGES, name)
        drawn = np.array([getattr(world, name) for world in worlds])
        assert low <= drawn.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < drawn.max() <= high
    for world in worlds:
        assert len(world.mu_patches) == RANGES.patches
        for patch in world.mu_patches:
            left, bottom, right, top = patch.cells
            assert abs(left - SIDE // 2) <= REACH
            assert RANGES.patch_cells[0] <= right - left + 1 <= RANGES.patch_cells[1]
            assert bottom <= top
        assert world.camera.rate_hz >= RANGES.rate_hz[0]
    assert len(set(map(repr, worlds))) == len(worlds)


def test_every_walk_has_a_world_of_its_own(monkeypatch):
    """In one batch, and the same whoever shares it."""
    monkeypatch.setattr(observe, "WALKS_OF_WORLDS", 2)
    monkeypatch.setattr(observe._Walker, "done", property(lambda walker: len(walker.moves) >= 2))
    seen = []
    begin = observe.Batch.begin

    def watched(batch, *arguments):
        seen.append(arguments[-1].world)
        return begin(batch, *arguments)

    monkeypatch.setattr(observe.Batch, "begin", watched)
    config = replace(CoSimConfig(), timing=TIMING._replace(move_limit_s=4.0))
    walked = [
        observe.observe_moves(config, cached_fmu(), worlds=RANGES, moves_per_kind=1, jobs=jobs)
        for jobs in (1, 2)
    ]
    assert walked[0] == walked[1]
    assert len(walked[0].walks) == observe.WALKS_OF_WORLDS
    assert sum(walked[0].walks) == len(walked[0].moves) >= 4
    assert seen[0] != seen[1]
    assert seen[:2] == sorted(seen[2:], key=seen[:2].index)
    ideal = observe.source_digest(config, cached_fmu())
    assert walked[0].source != ideal
