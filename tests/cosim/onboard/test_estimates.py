"""What the shield's proof takes for granted of a camera: errors within five standard deviations."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.model.params import SHIELD
from cosim.simulation.options import SimulationOptions, resolve
from cosim.simulation.tasks import Task, simulate_tasks
from tests.references.colliding import Random

WORLD = Path(__file__).parents[3] / "docs" / "examples" / "rough.toml"


# At the edges of the patches, and in them.
STARTS = (
    ((12, 14), (19, 9)),
    ((5, 4), (26, 10)),
    ((13, 21), (20, 15)),
    ((8, 20), (21, 26)),
    ((24, 13), (22, 5)),
    ((12, 8), (18, 22)),
)


def variances(covariance):
    """(...) largest variance in m² of positions, of (..., 6) covariances."""
    xx, xy, yy = covariance[..., 0], covariance[..., 1], covariance[..., 2]
    return np.linalg.eigvalsh(np.stack([xx, xy, xy, yy], -1).reshape(*xx.shape, 2, 2))[..., -1]


@pytest.mark.slow
def test_errors_across_patches_are_those_of_the_filter():
    """Unequal motors, bouncing feet and floors that the filter does not know of, all the same."""
    scenario, config, fmu = resolve(SimulationOptions(shield=True), "4", world=WORLD)
    config = replace(config, timing=config.timing._replace(episode_limit_s=20.0))
    alone, together, squared = [], [], []
    patches = np.array([patch.cells for patch in config.world.mu_patches])
    on_patch = np.zeros(len(patches))

    def watch(step, *_):
        samples = step.samples  # an estimate is of the pose at the end of the period before
        error = samples.estimate[1:, :, :2] - samples.position[:-1, :, :2]
        variance = variances(samples.covariance[1:])
        squared.append((error**2).sum(axis=2) / variance)
        alone.append(np.sqrt(squared[-1]).max())
        x, y = (samples.position[:, :, k, None] / scenario.cell_m for k in (0, 1))
        left, bottom, right, top = patches.T
        inside = (left <= x) & (x < right + 1) & (bottom <= y) & (y < top + 1)
        on_patch[:] += inside.sum(axis=(0, 1))
        between = np.linalg.norm(error[:, 0] - error[:, 1], axis=1)
        together.append((between / np.sqrt(variance.sum(axis=1))).max())

    tasks = [
        Task(scenario, fmu, config, Random(rng), starts, np.random.SeedSequence(k), watch=watch)
        for k, starts in enumerate(STARTS)
        for rng in [np.random.default_rng(k)]
    ]
    assert len(list(simulate_tasks(tasks, 1))) == len(STARTS)
    assert (on_patch > 10_000).all()  # 10 s of robots, or more
    assert max(alone) < SHIELD.deviations
    assert max(together) < SHIELD.deviations
    # twice one variance at most, the larger one: neither blind nor overcautious
    assert 0.5 < np.mean(np.concatenate(squared)) < 2.0
