"""Parts of a co-simulation made from its parameters."""

from dataclasses import replace

import numpy as np
import pytest

from cosim.coupling.assembly import draw_noise, noise_generators
from cosim.model.config import CoSimConfig


@pytest.mark.parametrize("hold", [1, 3])
def test_noise_of_a_motor_is_its_own_generators(hold):
    config = CoSimConfig()
    config = replace(config, noise=config.noise._replace(hold_s=hold * 1e-3))
    noise = draw_noise(config, noise_generators(np.random.SeedSequence(1), 2), 10)
    assert noise.shape == (10, 2, 2)
    for k, generator in enumerate(noise_generators(np.random.SeedSequence(1), 2)):
        held = np.repeat(generator.uniform(-1.0, 1.0, -(-10 // hold)), hold)[:10]
        assert np.array_equal(noise[:, k // 2, k % 2], held * config.noise.relative_amplitude)
