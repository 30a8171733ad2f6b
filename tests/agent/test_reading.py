"""Whatever is in a file, its reader gives a result or one sentence."""

import io
import logging
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.mdp.optimum import optimum
from agent.moves.model import ObservedMoves, build_model
from agent.training.loop import TrainingLog
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig, read_settings
from agent.training.store import LOG_FILE, find_or_make
from analysis.figures.style import Caption, read_caption, write_caption
from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_arrays
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from tests.agent.moves.test_moves import ideal_moves

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "four_crossing.toml"
LEARNING = LearningConfig(episodes=2000, epsilon_episodes=20, greedy_points=2)
SMALL = Scenario(
    "small", "", ((4, 0), (0, 4)), (((0, 0),), ((4, 4),)),
    columns=5, rows=5, robot_diameter_m=0.01, zone=(2, 2, 3, 3),
)  # fmt: skip
ANY = Kind("file", "fix it")


def read_moves(path):
    return build_model(ObservedMoves.load(path), 5.0)


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    """A real file of every kind, by its reader."""
    folder = tmp_path_factory.mktemp("seeds")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINIROBOTS_CACHE", str(folder / "cache"))
        _, _, path = find_or_make(PolicyConfig(SMALL, ProcessConfig(), LEARNING, Seed(0)))
    ideal_moves(duration_s=3.5, turn_s=0.5).save(folder / "moves.json")
    (folder / "settings.toml").write_text('[process]\nfeatures = ["x", "y"]\n[learning]\neta = 1\n')
    write_caption(Caption("fig03", "Motion", "it slides", ("5 µm",), {"step_um": 5.0}), folder)
    return {
        "policy": (path, Policy.load),
        "training": (path.with_name(LOG_FILE), TrainingLog.load),
        "moves": (folder / "moves.json", read_moves),
        "scenario": (EXAMPLE, find_scenario),
        "settings": (folder / "settings.toml", read_settings),
        "caption": (folder / "fig03.json", lambda p: read_caption(p.parent, p.stem)),
    }


KINDS = ("policy", "training", "moves", "scenario", "settings", "caption")


@pytest.mark.parametrize("kind", KINDS)
def test_real_files_are_read(seeds, kind):
    path, read = seeds[kind]
    assert read(path) is not None


@st.composite
def damage(draw, content):
    """The content with some bytes exchanged, a part taken out or repeated, or cut off."""
    content = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, max(len(content) - 1, 0)))
        how = draw(st.sampled_from(("flip", "byte", "cut", "take", "repeat", "put")))
        length = draw(st.integers(1, 64))
        if how == "cut":
            del content[at:]
        elif how == "take":
            del content[at : at + length]
        elif how == "repeat":
            content[at:at] = content[at : at + length]
        elif how == "put":
            content[at:at] = draw(st.binary(max_size=16))
        elif at < len(content):
            content[at] = draw(st.integers(0, 255)) if how == "byte" else content[at] ^ 0x10
    return bytes(content)


def headers(content):
    """Places in a zip that say what is in it, where a change matters most."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
    local = [m.header_offset + k for m in members for k in range(30 + len(m.filename))]
    return [*local, *range(content.index(b"PK\1\2"), len(content))]


@pytest.mark.parametrize("kind", KINDS)
@settings(
    max_examples=150,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(data=st.data())
def test_damage_gives_a_result_or_a_sentence(seeds, tmp_path, kind, data):
    path, read = seeds[kind]
    content = path.read_bytes()
    if path.suffix == ".npz" and data.draw(st.booleans()):
        changed = bytearray(content)
        for at in data.draw(st.lists(st.sampled_from(headers(content)), min_size=1, max_size=3)):
            changed[at] = data.draw(st.integers(0, 255))
        content = bytes(changed)
    else:
        content = data.draw(damage(content))
    damaged = tmp_path / path.name
    damaged.write_bytes(content)
    try:
        read(damaged)
    except UserError as error:
        assert str(error)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda p: None, "no such"),
        (lambda p: p.mkdir(), "a folder"),
        (os.mkfifo, "a device or a pipe"),
        (lambda p: p.symlink_to("/dev/zero"), "a device or a pipe"),
        (lambda p: p.symlink_to(p), "Too many levels of symbolic links"),
        (lambda p: p.write_bytes(b"[" * 100_000), ""),
        (lambda p: p.write_bytes(b"\xff\xfe\x00" * 10), ""),
    ],
)
def test_what_is_no_such_file_is_named(seeds, tmp_path, kind, make, said):
    path, read = seeds[kind]
    wrong = tmp_path / path.name
    make(wrong)
    with pytest.raises(UserError, match=f"{path.stem}.*{said}"):
        read(wrong)


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,)}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,)}",
        "{'descr': '<U0', 'fortran_order': False, 'shape': (1,)}",
        "{'descr': '|O', 'fortran_order': False, 'shape': (1,)}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (0, 1)}",
        "{'descr': '<f8', 'fortran_order': ",
        "(((((",
    ],
)
def test_arrays_that_claim_another_size_are_refused(tmp_path, header):
    path, size = tmp_path / "a.npz", len(header).to_bytes(2, "little")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", b"\x93NUMPY\1\0" + size + header.encode() + b"12345678")
    with pytest.raises(UserError, match="not a file or damaged"):
        read_arrays(path, ANY, ["a"])


def test_arrays_are_read_as_they_were_written(tmp_path):
    path = tmp_path / "a.npz"
    arrays = {
        "plain": np.arange(6.0).reshape(2, 3),
        "turned": np.asfortranarray(np.arange(6).reshape(2, 3)),
        "empty": np.zeros((0, 3), dtype=np.float32),
        "number": np.array(3),
        "text": np.array("µ"),
    }
    np.savez_compressed(path, **arrays)
    read = read_arrays(path, ANY, [*arrays])
    for name, array in arrays.items():
        assert np.array_equal(read[name], array)
        assert (read[name].dtype, read[name].flags.writeable) == (array.dtype, True)
    assert read["turned"].flags.f_contiguous
    with pytest.raises(UserError, match=r"lacks 'other'"):
        read_arrays(path, ANY, ["other"])


@pytest.mark.usefixtures("fresh_cache")
def test_damaged_optima_are_computed_again(tmp_path, caplog):
    process = build_process(SMALL, ProcessConfig())
    bound = optimum(process)
    (path,) = (tmp_path / "cache" / "bounds").glob("*.npz")
    content = path.read_bytes()
    np.savez(path, steps=np.zeros(3))
    with caplog.at_level(logging.WARNING):
        again = optimum(process)
    assert str(path) in caplog.text
    assert np.array_equal(again.path_cells, bound.path_cells)
    assert path.read_bytes() == content


@pytest.mark.usefixtures("fresh_cache")
def test_a_folder_in_the_cache_is_told_before_a_policy_is_trained():
    config, seen = PolicyConfig(SMALL, ProcessConfig(), LEARNING, Seed(0)), []
    *_, policy = find_or_make(config)
    policy.unlink()
    policy.mkdir()
    with pytest.raises(UserError, match="a folder is where this file goes"):
        find_or_make(config, progress=lambda *now, **_: seen.append(now))
    assert not seen
