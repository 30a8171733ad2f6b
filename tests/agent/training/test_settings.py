"""Settings files are read, and wrong fields are named."""

import pytest

from agent.mdp.config import ProcessConfig
from agent.training.settings import LearningConfig, read_settings
from cosim.base.errors import UserError


def test_given_fields_override_defaults(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(
        '[process]\nfeatures = ["x", "y"]\ncollision = "swept"\n[learning]\neta = 0.5\n'
    )
    process, learning = read_settings(path)
    assert process == ProcessConfig(features=("x", "y"), collision="swept")
    assert learning == LearningConfig(eta=0.5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[proces]\n", "table proces is unknown"),
        ("[process]\nslip = 1\n", "process.slip is unknown"),
        ('[learning]\neta = "big"\n', "learning: eta = .*xpected float, got str"),
        ("[learning]\neta = 2.0\n", "eta = 2.0 is invalid: expected float <= 1.0"),
        ("[learning]\neta = 0.0\n", "eta = 0.0 is invalid"),
        ("[learning]\ngamma = 1.1\n", "gamma = 1.1 is invalid"),
        ("[learning]\nepisodes = 0\n", "episodes = 0 is invalid"),
        ("[learning]\nepsilon = -1.0\n", "epsilon = -1.0 is invalid"),
        ('[process]\nfeatures = ["q"]\n', r"process: features\[0\] = 'q' is unknown"),
        ("[process\n", "not a TOML file"),
    ],
)
def test_wrong_files_are_refused(tmp_path, text, message):
    path = tmp_path / "s.toml"
    path.write_text(text)
    with pytest.raises(UserError, match=message):
        read_settings(path)
