"""The Python API as a program meets it: train, keep, simulate, look back, refusals."""

import copy
import gc
import pickle
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import agent
import analysis
import cosim
import minirobots as mr
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.base.progress import silent
from cosim.model.config import CoSimConfig
from cosim.simulation.batch import Batch
from cosim.simulation.options import EpisodeOptions
from fmus.build import cached_fmu
from minirobots.commands.episodes import Run
from tests.alone import rrd

BRIEF: dict[str, Any] = {"mu": 0.2, "time_limit": 4.0}


class Told:
    """Progress that remembers what it was told last of each task: done and total."""

    def __init__(self) -> None:
        self.last: dict[str, tuple[float, float | None]] = {}

    def __call__(self, task: str, done: float, total: float | None, state: str = "") -> None:
        self.last[task] = done, total


class Upwards:
    """A policy that says nothing of what it thinks."""

    def act(self, observation: cosim.Observation) -> np.ndarray:
        return np.full(len(observation.cells), 2)


def signals(episode: cosim.Episode) -> dict[str, tuple]:
    """Every signal, to be compared bit by bit."""
    return {
        name: (s.time_s.tobytes(), s.values.tobytes(), s.values.shape, s.values.dtype, *s[2:])
        for name, s in episode.signals.items()
    }


@pytest.fixture(scope="module")
def policy() -> "agent.Policy":
    return agent.train("1a", method="paper", episodes=20_000)


@pytest.fixture(scope="module")
def episode(policy) -> cosim.Episode:
    return cosim.simulate("1a", policy, seed=3, **BRIEF)


def test_trained_kept_simulated_and_opened_again(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    agent.train("1a", method="paper", episodes=20_000).save("policy.npz")
    episode = cosim.simulate("1a", agent.load("policy.npz"), **BRIEF)
    episode.save("episode.rrd")
    opened = analysis.open("episode.rrd")

    files = {path.name for path in tmp_path.iterdir()}
    assert files == {"policy.npz", "policy.json", "episode.rrd"}
    assert agent.load("policy.npz", "1a").episodes == 20_000
    with pytest.raises(UserError, match="no such policy file"):
        agent.load(Path("nowhere.npz"))
    with pytest.raises(UserError, match="was trained on scenario 1a"):
        agent.load("policy.npz", cosim.find_scenario("2"))
    assert (episode.outcome, episode.time_s) == ("timeout", 4.0)
    omega = episode.signals["r1/motors/omega"]
    assert omega.values.shape == (len(omega.time_s), 2)
    assert omega.time_s[-1] == 4.0
    assert signals(opened) == signals(episode)
    assert opened.facts["scenario"] == "1a"
    assert opened.parameter("mu") == 0.2
    assert opened.moves["r1"]


def test_simulate_is_the_first_episode_of_a_run(policy, episode, tmp_path):
    policy.save(tmp_path / "policy.npz")
    run = Run(
        scenario="1a",
        policy=tmp_path / "policy.npz",
        out=tmp_path / "run",
        physics=EpisodeOptions(seed=3, **BRIEF),
    )
    (result,) = run.run(silent).result["episodes"]
    assert result.recording is not None
    of_run = analysis.open(tmp_path / "run" / result.recording)
    assert signals(of_run) == signals(episode)
    assert (result.outcome, result.sim_time_s) == (episode.outcome, episode.time_s)
    assert of_run.parameters == episode.parameters
    assert of_run.recording_id == episode.recording_id
    assert signals(cosim.simulate("1a", policy, seed=4, **BRIEF)) != signals(episode)


def test_files_of_another_name_are_refused(policy, episode, tmp_path):
    for saved, ending in ((policy, "npz"), (episode, "rrd"), (cosim.find_preset("paper"), "toml")):
        with pytest.raises(UserError, match=rf"x\.txt: its name must end in \.{ending}; choose"):
            saved.save(tmp_path / "x.txt")
    assert not list(tmp_path.iterdir())


def test_recording_in_memory_is_that_of_its_file(episode, tmp_path):
    """Values, times, units, states, parameters and all else that an episode says."""
    episode.save(tmp_path / "new" / "episode.rrd")
    read = analysis.open(tmp_path / "new" / "episode.rrd")
    assert list(read.signals) == list(episode.signals)
    assert signals(read) == signals(episode)
    assert read.texts.keys() == episode.texts.keys()
    for name, states in episode.texts.items():
        assert read.texts[name].texts == states.texts
        np.testing.assert_array_equal(read.texts[name].time_s, states.time_s)
    apart = ("recording", "signals", "texts")
    ours, theirs = ({k: v for k, v in vars(e).items() if k not in apart} for e in (episode, read))
    assert ours == theirs
    assert read.complete


def test_a_recording_is_a_file_once_its_path_is_asked_for(policy, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    episode = cosim.simulate("1a", policy, record="summary", **BRIEF)
    assert not list(tmp_path.rglob("*.rrd*"))
    folder = episode.path.parent
    assert [path.name for path in folder.iterdir()] == ["episode.rrd"]
    del episode
    gc.collect()
    assert not folder.exists()
    assert not list(tmp_path.rglob("*.rrd*"))


def test_policy_may_only_act(episode):
    mute = cosim.simulate("1a", Upwards(), **BRIEF)
    of_policy = {"/rl/r1/q_s", "/rl/r1/reward", "/rl/r1/reward_parts", "/rl/r1/return"}
    assert set(episode.signals) - set(mute.signals) == of_policy
    assert set(episode.texts) - set(mute.texts) == {"/rl/r1/greedy"}
    assert {move.direction for move in mute.moves["r1"]} == {"90°"}


class Torn:
    """A policy that values all directions alike, and chooses among them alone."""

    asked = 0

    def act(self, observation: cosim.Observation) -> cosim.Decision:
        self.asked += 1
        values = np.full((len(observation.cells), 8), self.asked, dtype=float)
        return cosim.Decision(3 + observation.cells[:, 0] % 2, values)


def test_the_recorded_greedy_action_is_what_the_policy_chose():
    episode = cosim.simulate("1a", Torn(), **BRIEF)
    cells = episode.signals["/rl/r1/cell"].values[:, 0]
    chosen = ["135°" if x % 2 == 0 else "180°" for x in cells.astype(int).tolist()]
    assert list(episode.texts["/rl/r1/greedy"].texts) == chosen[: len(chosen) - 1]
    assert episode.signals["/rl/r1/q_s"].values[:, 0].tolist() == list(range(1, len(chosen)))


def test_progress_is_told_every_task_of_a_method_to_its_end(policy):
    built_in = {name for name in agent.methods() if ":" not in name}
    assert built_in == {"paper", "double_q", "moves", "shortest", "fastest", "planned"}
    told = Told()
    agent.train("1a", method="paper", episodes=20_000, again=True, progress=told)
    assert told.last == {"training": (20_000, 20_000)}
    told = Told()
    again = agent.train("1a", method="paper", episodes=20_000, progress=told)
    assert told.last == {}  # it was there
    assert again.digest() == policy.digest()
    cosim.simulate("1a", policy, progress=told, **BRIEF)
    assert told.last["simulating"] == (4.0, 4.0)
    assert all(done == total for done, total in told.last.values()), told.last


REFUSED: dict[str, dict[str, Any]] = {  # what a message says, and options that are refused with it
    "option friction is unknown; choose one of .*mu": {"friction": 0.2},
    " is unknown; choose one of ": {"driver": "fast", "on_collision": "stop", "open_loop": "on"},
    "record = 'none' keeps nothing": {"record": "none"},
    "unknown scenario '7'": {"scenario": "7"},
    "the policy was trained on scenario 1a .* scenario 2 ": {"scenario": "2"},
    "seed = .* is invalid: expected int <= ": {"seed": 2**63},
    "seed = None is invalid: expected int": {"seed": None},
    "seed = -1 is invalid: expected int >= 0": {"seed": -1},
    "motor_fmu = 5 is invalid: expected Path": {"motor_fmu": 5},
    "shield = 'yes' is invalid: expected bool": {"shield": "yes"},
    "mu = '0.2' is invalid: expected float": {"mu": "0.2"},
    r"mu = \[0.2\] is invalid": {"mu": np.array([0.2])},
    "mu = -1.0 is invalid": {"mu": -1.0},
    "mu = 0 .*; change the preset": {"mu": 0.0},
    r" = 0(\.0)? is invalid: expected float > 0": {
        "time_limit": 0, "rl_step": 0.0, "communication_step": 0
    },
    "world.muu is unknown; choose one of .*did you mean mu": {"world": {"muu": 1}},
    "world = 5 is invalid": {"world": 5},
    r"policy = 'P.npz' has no act\(observation\)": {"policy": "P.npz"},
    "policy = <class .* has no act": {"policy": Upwards},
    "nowhere.fmu does not exist": {"motor_fmu": "nowhere.fmu"},
}  # fmt: skip


@pytest.mark.parametrize(
    ("message", "name", "value"),
    [(message, *option) for message, given in REFUSED.items() for option in given.items()],
)
def test_simulate_refuses_what_it_does_not_know(policy, message, name, value):
    arguments = {"scenario": "1a", "policy": policy, name: value}
    with pytest.raises(UserError, match=message):
        cosim.simulate(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scenario": "7"}, "unknown scenario '7'"),
        ({"method": "luck"}, "'luck' is unknown; choose one of paper, double_q"),
        ({"method": ["paper"]}, "method = .* is unknown; choose one of paper"),
        ({"motor_fmu": "my.fmu"}, "motor_fmu has no effect .* method paper"),
        ({"motor_parameters": {"J": 5e-9}}, "motor_parameters has no effect .* paper"),
        ({"motor_parameters": {"J": "heavy"}, "method": "moves"}, "motor_parameters"),
        ({"motor_parameters": {"K": 5e-9}, "method": "moves"}, "no parameter 'K'"),
        ({"motor_parameters": {"J": np.nan}, "method": "moves"}, "J = nan"),
        ({"episodes": 0}, "episodes"),
        ({"episodes": 0.5}, "episodes = 0.5 is invalid: expected int"),
        ({"seed": -1}, "seed"),
        ({"again": "yes"}, "again = 'yes' is invalid: expected bool"),
        ({"method": "shortest", "seed": 5}, "seed has no effect .* it is computed"),
        ({"progress": True}, "progress = True is no function"),
    ],
)
def test_train_refuses_what_it_does_not_know(arguments, message):
    with pytest.raises(UserError, match=message):
        agent.train(**{"scenario": "1a", "method": "paper"} | arguments)


def test_values_as_programs_have_them_give_the_same_bits(policy):
    """NumPy scalars, a string for a tuple, dicts, records and lists for what they stand for."""
    world = {"mu": np.float64(0.2), "sensor": {"rate_hz": np.int64(30)}}
    record = cosim.World(mu=0.2, sensor=cosim.Sensor(rate_hz=30.0))
    board = cosim.find_scenario("1a")
    listed = replace(board, targets=[np.array(board.targets[0])])
    assert (listed, listed.digest()) == (board, board.digest())
    brief: dict[str, Any] = {"time_limit": 2.0, "record": "summary"}
    found = [
        cosim.simulate(scenario, policy, **{**brief, **options})
        for scenario, options in (
            ("1a", {"seed": 3, "world": world, "open_loop": ("motors",)}),
            (board, {"seed": np.int64(3), "world": record, "open_loop": "motors"}),
            (listed, {"seed": 3, "world": record, "open_loop": np.array(["motors"])}),
            (Path("1a"), {"seed": np.uint8(3), "world": record, "time_limit": np.float32(2.0),
                          "open_loop": ["motors"], "preset": cosim.find_preset("paper")}),
        )
    ]  # fmt: skip
    assert all(signals(episode) == signals(found[0]) for episode in found)
    assert found[0].parameter("mu") == 0.2


def test_a_policy_may_return_a_list_where_signals_of_some_robots_are_kept():
    listed: Any = SimpleNamespace(act=lambda observation: [2] * len(observation.cells))
    brief: dict[str, Any] = {"signals": [2], "time_limit": 2.0}
    found = [cosim.simulate("2", acting, **brief) for acting in (listed, Upwards())]
    assert signals(found[0]) == signals(found[1])


def test_the_order_in_which_robots_are_named_changes_no_signal():
    brief: dict[str, Any] = {"time_limit": 2.0}
    found = [cosim.simulate("2", Upwards(), **brief, signals=named) for named in ((), (2, 1))]
    assert signals(found[0]) == signals(found[1])


def test_episodes_can_be_pickled_and_copied(policy, tmp_path):
    episode = cosim.simulate("1a", policy, record="summary", time_limit=2.0)
    copies = [pickle.loads(pickle.dumps(copy.deepcopy(episode)))]
    copies[0].save(tmp_path / "copy.rrd")
    copies.append(analysis.open(tmp_path / "copy.rrd"))
    for other in copies:
        assert signals(other) == signals(episode)
        assert (other.recording_id, other.facts) == (episode.recording_id, episode.facts)


def test_paths_are_refused_by_name(episode):
    for call in (agent.load, analysis.open, episode.save):
        with pytest.raises(ConfigError, match="path = 5 is invalid: expected Path, got int"):
            call(5)  # pyright: ignore
    with pytest.raises(UserError, match="a folder, no recording"):
        analysis.open("")


def test_records_convert_what_they_are_given():
    robot = CoSimConfig().robot
    assert type(CoSimConfig(robot=robot._replace(mu=np.float32(0.5))).robot.mu) is float
    with pytest.raises(ConfigError, match="mu = 'x' is invalid: expected float"):
        CoSimConfig(robot=robot._replace(mu="x"))
    with pytest.raises(UserError, match=r"targets\[0\]\[0\] = 3.5 is invalid: expected int"):
        replace(cosim.find_scenario("1a"), targets=[[3.5, 3]])


def test_a_batch_takes_numbers_and_lists():
    scenario, starts, fmu = cosim.find_scenario("1a"), np.array([[15, 29]]), str(cached_fmu())
    batch, seed = Batch(fmu, CoSimConfig(), 1, 1), np.random.SeedSequence(0)  # pyright: ignore
    episode = batch.begin(0, scenario, starts, seed)  # pyright: ignore
    assert episode.observation.cells.tolist() == [[15, 29]]
    with pytest.raises(ConfigError, match="must have a cell for each robot"):
        batch.begin(0, scenario, ((15, 29), (0, 0)), seed)
    with pytest.raises(ConfigError, match="driver = 'fast' is unknown"):
        Batch(cached_fmu(), CoSimConfig(), 1, 1, driver="fast")
    batch.close()


@pytest.mark.parametrize(
    "read",
    [
        mr.open, agent.load, cosim.find_preset,
        lambda path: agent.train("1b", method="moves", motor_fmu=path),
    ],
)  # fmt: skip
def test_pointers_of_git_lfs_are_named(tmp_path, read):
    path = tmp_path / "a.toml"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    with pytest.raises(UserError, match="a pointer of Git LFS, not the file; run `git lfs pull`"):
        read(path)


@pytest.mark.long
def test_recordings_are_known_by_what_determines_the_episode(policy, tmp_path):
    class Local(Upwards):
        """Has no digest."""

    def one(name, policy, **options):
        options = {"time_limit": 2.0, "record": "summary", "progress": None} | options
        episode = cosim.simulate("1a", policy, seed=3, **options)
        episode.save(tmp_path / f"{name}.rrd")
        return episode.recording_id

    shortest = agent.train("1a", method="shortest")
    found = [one("a", policy), one("b", policy, mu=0.2), one("c", shortest), one("d", Local())]
    assert len(set(found)) == 4
    assert one("again", policy) == found[0]
    one("e", policy)  # the same recording as a
    for names, message in (("ab", "holds 2 recordings"), ("ae", "holds 2 episodes merged into")):
        files, both = [tmp_path / f"{name}.rrd" for name in names], tmp_path / f"{names}.rrd"
        assert rrd("merge", *files, "-o", both)
        with pytest.raises(UserError, match=message):
            analysis.open(both)
