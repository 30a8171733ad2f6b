"""What a camera makes of robots is recorded beside the truth, and only where there is one."""

from pathlib import Path

import numpy as np
import pytest

from cosim import simulate
from cosim.recording.reader import Episode

WORLD = Path(__file__).parents[3] / "docs" / "examples" / "rough.toml"


class Ahead:
    """Drives every robot upwards."""

    def act(self, observation):
        return np.full(len(observation.cells), 2)


@pytest.fixture(scope="module", params=[None, WORLD], ids=["exact", "camera"])
def recorded(request) -> tuple[bool, Episode]:
    options = {} if request.param is None else {"world": request.param}
    episode = simulate("2", Ahead(), time_limit=4.0, record="summary", **options)
    return request.param is not None, episode


@pytest.mark.long
def test_truth_and_estimate_are_recorded(recorded):
    camera, episode = recorded
    assert ("/sim/r1/estimate/position" in episode.signals) == camera
    if camera:
        truth, seen = (episode.signals[f"r1/{name}position"].values for name in ("", "estimate/"))
        off = np.linalg.norm(seen - truth, axis=1)
        assert 0.0 < off.max() < 2e-3
        assert (episode.signals["r1/estimate/covariance"].values[:, [0, 2, 5]] > 0.0).all()
