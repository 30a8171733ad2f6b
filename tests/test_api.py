"""The Python API as a program meets it: train, keep, simulate, look back, refusals."""

import copy
import gc
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
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
from cosim.simulation.options import EpisodeOptions
from fmus.build import cached_fmu
from minirobots.commands.episodes import Run

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
        name: (s.time_s.tobytes(), s.values.tobytes(), s.values.shape, s.unit, s.components)
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

    assert {path.name for path in tmp_path.iterdir()} == {
        "policy.npz",
        "policy.json",
        "episode.rrd",
    }
    assert (episode.outcome, episode.time_s) == ("timeout", 4.0)
    omega = episode.signals["r1/motors/omega"]
    assert omega.values.shape == (len(omega.time_s), 2)
    assert omega.time_s[-1] == 4.0
    assert signals(opened) == signals(episode)
    for name in ("outcome", "time_s", "robots", "facts", "parameters", "moves", "complete"):
        assert getattr(opened, name) == getattr(episode, name), name
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


def test_files_of_another_name_are_refused(policy, episode, tmp_path):
    for saved, ending in ((policy, "npz"), (episode, "rrd"), (cosim.find_preset("paper"), "toml")):
        with pytest.raises(
            UserError, match=rf"x\.txt: its name must end in \.{ending}; choose x\."
        ):
            saved.save(tmp_path / "x.txt")
    assert not list(tmp_path.iterdir())


def test_another_seed_is_another_episode(policy, episode):
    assert signals(cosim.simulate("1a", policy, seed=4, **BRIEF)) != signals(episode)


def test_recording_in_memory_is_that_of_its_file(episode, tmp_path):
    """Values, times, units, states, parameters and all else that an episode says."""
    episode.save(tmp_path / "new" / "episode.rrd")
    read = analysis.open(tmp_path / "new" / "episode.rrd")
    assert list(read.signals) == list(episode.signals)
    for name, signal in episode.signals.items():
        again = read.signals[name]
        assert again.values.dtype == signal.values.dtype
        np.testing.assert_array_equal(again.values, signal.values)
        np.testing.assert_array_equal(again.time_s, signal.time_s)
        assert (again.components, again.unit) == (signal.components, signal.unit)
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


def test_methods_are_told_and_train_however_often_they_are_asked_for(policy):
    assert set(agent.methods()) == {"paper", "moves", "shortest", "fastest", "planned"}
    again = agent.train("1a", method="paper", episodes=20_000)
    assert again.digest() == policy.digest()


def test_progress_is_told_every_task_to_its_end(policy):
    told = Told()
    agent.train("1a", method="paper", episodes=20_000, again=True, progress=told)
    assert told.last == {"training": (20_000, 20_000)}
    told = Told()
    agent.train("1a", method="paper", episodes=20_000, progress=told)
    assert told.last == {}  # it was there
    cosim.simulate("1a", policy, progress=told, **BRIEF)
    assert told.last["simulating"] == (4.0, 4.0)
    assert all(done == total for done, total in told.last.values()), told.last


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"friction": 0.2}, ConfigError, "no option friction; choose from .*mu.*time_limit"),
        ({"driver": "fast"}, ConfigError, "driver = 'fast' is unknown; choose one of fmpy, "),
        ({"record": "none"}, ConfigError, "record = 'none' keeps nothing"),
        ({"on_collision": "stop"}, ConfigError, "on_collision = 'stop' is unknown; choose one of"),
        ({"scenario": "7"}, UserError, "unknown scenario '7'"),
        ({"scenario": "2"}, UserError, "the policy was trained on scenario 1a .* scenario 2 "),
        ({"seed": -1}, ConfigError, "seed = -1 is invalid: expected int >= 0"),
        ({"seed": 2**63}, ConfigError, "is invalid: expected int <= "),
        ({"seed": None}, ConfigError, "seed = None is invalid: expected int"),
        ({"seed": True}, ConfigError, "seed = True is invalid: expected int"),
        ({"mu": "0.2"}, ConfigError, "mu = '0.2' is invalid: expected float"),
        ({"mu": np.array([0.2])}, ConfigError, r"mu = array\(\[0.2\]\) is invalid"),
        ({"open_loop": "wheels"}, ConfigError, "open_loop = 'wheels' is unknown; choose one of"),
        ({"shield": "yes"}, ConfigError, "shield = 'yes' is invalid: expected bool"),
        ({"time_limit": 0}, ConfigError, "time_limit = 0.0 must be finite and positive"),
        ({"rl_step": 0.0}, ConfigError, "rl_step = 0.0 must be finite and positive"),
        ({"communication_step": 0}, ConfigError, "communication_step = 0.0 must be finite and"),
        ({"preset": 5}, ConfigError, "preset = 5 is invalid: expected str"),
        ({"motor_fmu": 5}, ConfigError, "motor_fmu = 5 is invalid: expected Path"),
        ({"world": {"muu": 1}}, UserError, "world = .* is invalid: object .* unknown field muu"),
        ({"world": 5}, UserError, "world = 5 is invalid"),
        ({"policy": "P.npz"}, ConfigError, r"policy = 'P.npz' has no act\(observation\)"),
        ({"policy": Upwards}, ConfigError, "policy = <class .* has no act"),
        ({"scenario": None}, UserError, "unknown scenario 'None'"),
        ({"mu": -1.0}, ConfigError, "mu = -1.0 must be"),
        ({"motor_fmu": "nowhere.fmu"}, UserError, "nowhere.fmu does not exist"),
    ],
)
def test_simulate_refuses_what_it_does_not_know(policy, arguments, error, message):
    arguments = {"scenario": "1a"} | arguments
    with pytest.raises(error, match=message):
        cosim.simulate(**{"policy": policy, **arguments})


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"scenario": "7"}, UserError, "unknown scenario '7'"),
        (
            {"method": "luck"},
            UserError,
            "method 'luck' is unknown; choose one of paper, moves",
        ),
        ({"motor_fmu": "my.fmu"}, UserError, "motor_fmu has no effect .* method paper"),
        ({"motor_parameters": {"J": 5e-9}}, UserError, "motor_parameters has no effect .* paper"),
        ({"motor_parameters": {"J": "heavy"}, "method": "moves"}, ConfigError, "motor_parameters"),
        ({"motor_parameters": {"K": 5e-9}, "method": "moves"}, UserError, "no parameter 'K'"),
        ({"motor_parameters": {"J": np.nan}, "method": "moves"}, UserError, "J = nan"),
        ({"episodes": 0}, UserError, "episodes"),
        ({"seed": -1}, UserError, "seed"),
        ({"seed": "1"}, ConfigError, "seed = '1' is invalid: expected int"),
        ({"episodes": 0.5}, ConfigError, "episodes = 0.5 is invalid: expected int"),
        ({"again": "yes"}, ConfigError, "again = 'yes' is invalid: expected bool"),
        ({"method": ["paper"]}, ConfigError, "method = .* is invalid: expected str"),
        ({"method": "shortest", "seed": 5}, UserError, "seed = 5 has no effect: .* is computed"),
        ({"progress": True}, UserError, "progress = True is no function"),
    ],
)
def test_train_refuses_what_it_does_not_know(arguments, error, message):
    arguments = {"scenario": "1a", "method": "paper"} | arguments
    with pytest.raises(error, match=message):
        agent.train(**arguments)


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
    class Listed:
        def act(self, observation: cosim.Observation) -> list[int]:
            return [2] * len(observation.cells)

    brief: dict[str, Any] = {"signals": [2], "time_limit": 2.0}
    found = [cosim.simulate("2", acting, **brief) for acting in (Listed(), Upwards())]  # pyright: ignore
    assert signals(found[0]) == signals(found[1])


def test_episodes_can_be_pickled_and_copied(policy, tmp_path):
    episode = cosim.simulate("1a", policy, record="summary", time_limit=2.0)
    copies = [pickle.loads(pickle.dumps(copy.deepcopy(episode)))]
    copies[0].save(tmp_path / "copy.rrd")
    copies.append(analysis.open(tmp_path / "copy.rrd"))
    for other in copies:
        assert signals(other) == signals(episode)
        assert (other.recording_id, other.facts) == (episode.recording_id, episode.facts)


def test_mistakes_are_value_errors_with_an_exported_base():
    assert issubclass(cosim.ConfigError, ValueError)
    assert issubclass(cosim.ConfigError, cosim.UserError)
    assert agent.UserError is cosim.UserError


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
    with pytest.raises(UserError, match=r"targets = .* is invalid: expected int"):
        replace(cosim.find_scenario("1a"), targets=[[3.5, 3]])


def test_a_co_simulation_takes_numbers_and_lists():
    system = cosim.CoSimulation(cosim.find_scenario("1a"), str(cached_fmu()))  # pyright: ignore
    assert system.reset(np.array([[15, 29]]), np.int64(0)).cells.tolist() == [[15, 29]]  # pyright: ignore
    with pytest.raises(ConfigError, match="must have a cell for each robot"):
        system.reset(((15, 29), (0, 0)), 0)
    with pytest.raises(ConfigError, match="driver = 'fast' is unknown"):
        cosim.CoSimulation(cosim.find_scenario("1a"), cached_fmu(), driver="fast")
    system.close()


def test_load_refuses_what_does_not_fit(policy, tmp_path):
    with pytest.raises(UserError, match="no such policy file"):
        agent.load(Path("nowhere.npz"))
    policy.save(tmp_path / "policy.npz")
    assert agent.load(tmp_path / "policy.npz", "1a").episodes == 20_000
    with pytest.raises(UserError, match="was trained on scenario 1a"):
        agent.load(tmp_path / "policy.npz", cosim.find_scenario("2"))


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


def test_robots_without_friction_are_refused_by_their_friction(policy):
    with pytest.raises(UserError, match=r"mu = 0 .*; change the preset"):
        cosim.simulate("1a", policy, mu=0.0)


@pytest.mark.long
def test_recordings_are_known_by_what_determines_the_episode(policy, tmp_path):
    class Told:
        """Cannot be pickled, as it is local."""

        def act(self, observation):
            return [2] * len(observation.cells)

    def one(name, policy, **options):
        options = {"time_limit": 2.0, "record": "summary", "progress": None} | options
        episode = cosim.simulate("1a", policy, seed=3, **options)
        episode.save(tmp_path / f"{name}.rrd")
        return episode.recording_id

    shortest = agent.train("1a", method="shortest")
    found = [one("a", policy), one("b", policy, mu=0.2), one("c", shortest), one("d", Told())]
    assert len(set(found)) == 4
    assert one("again", policy) == found[0]
    merge = [sys.executable, "-m", "rerun", "rrd", "merge"]
    for names, said in (("ab", "holds 2 recordings"), ("ae", "holds 2 episodes merged into one")):
        files = [tmp_path / f"{name}.rrd" for name in names]
        if not files[1].exists():  # the same recording twice
            cosim.simulate("1a", policy, seed=3, time_limit=2.0, record="summary").save(files[1])
        both = tmp_path / f"{names}_both.rrd"
        subprocess.run([*merge, *files, "-o", both], check=True, capture_output=True)
        with pytest.raises(UserError, match=said):
            analysis.open(both)
