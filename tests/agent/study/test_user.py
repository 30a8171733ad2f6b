"""Studies of a user's own: axes, policies of any kind, files, resuming, and what is refused."""

import importlib
import json
import sqlite3
import sys
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from pyarrow import parquet

from agent.evaluation.cases import Case
from agent.study.engine import lines_of
from agent.study.policies import ObjectPolicy, policy_of
from agent.study.report import Report
from agent.study.store import EpisodeStore
from agent.study.user import evaluate, read_study, study
from agent.training.methods import method_config
from agent.training.policy import Policy
from agent.training.settings import LearningConfig
from agent.training.store import find_or_make
from cosim.base.errors import UserError
from cosim.base.progress import silent
from cosim.base.provenance import identity_of
from cosim.model.config import CoSimConfig
from cosim.model.scenario_file import find_in_world, find_scenario
from cosim.model.world import World
from cosim.simulation.simulate import draw_episode, simulate
from minirobots.commands.policies import Study
from tests.agent.conftest import NEAR

LIMIT_S = 4.0


class Stubborn:
    """Drives in one direction only, which ends no episode within the time limit."""

    def __init__(self, direction: int = 0) -> None:
        self.direction = direction

    def act(self, observation):
        return np.full(len(observation.cells), self.direction)


class Named(Stubborn):
    """Says what it is known by."""

    def digest(self):
        return self.direction


def test_a_policy_is_made_for_every_machine_of_a_study(monkeypatch):
    made: list[str] = []

    def make(_: object, *rest: Any, options: Any, **how: Any) -> Any:
        made.append(str(options.machine))
        if len(made) == 2:
            raise UserError("made twice")
        return policy_of(Stubborn(), *rest, options=options, **how)

    monkeypatch.setattr("agent.study.engine.policy_of", make)
    with pytest.raises(UserError, match="made twice"):
        study(["shortest"], "1a", preset=["paper", "thesis"], episodes=1, time_limit=LIMIT_S)
    assert made[0] != made[1]


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    return tmp_path_factory.mktemp("study")


def measured(out, near_file, **options) -> Report:
    policies = {"near": near_file, "stubborn": Named()}
    axes = {"noise": [0.0, 0.05], "shield": False}
    return study(policies, NEAR, episodes=2, jobs=1, out=out, time_limit=40.0, **axes, **options)


@pytest.fixture(scope="module")
def table(out, near_file) -> Report:
    return measured(out, near_file)


@pytest.mark.long
def test_rows_are_policies_with_every_value_of_the_axes(table):
    assert table.axes == ("noise",)
    assert [(row.policy, row.options) for row in table.rows] == [
        (policy, {"noise": noise}) for policy in ("near", "stubborn") for noise in (0.0, 0.05)
    ]
    assert [row.success for row in table.rows] == [1.0, 1.0, 0.0, 0.0]
    assert all(row.success_low < row.success_high for row in table.rows)
    assert [len(row.failures) for row in table.rows] == [0, 0, 2, 2]
    assert table.rows[0].path_ratio_to_grid is not None
    assert table.rows[2].path_ratio_to_grid is None


@pytest.mark.ci
def test_it_resumes(table, out, near_file, monkeypatch):
    monkeypatch.setattr(EpisodeStore, "keep", lambda *_: pytest.fail("simulated again"))
    assert measured(out, near_file) == table


def test_files_say_what_the_table_says(table, out):
    text = table.to_markdown().splitlines()
    assert len(text) == 2 + len(table.rows)
    assert text[2].startswith("| near | near | 0 | 1 | 2 | 100.0% [")
    assert (out / "study.md").read_text("utf-8").splitlines() == text
    assert len(json.loads((out / "study.json").read_text("utf-8"))["rows"]) == 4
    rows = table.to_pandas()
    assert list(rows.groupby("policy").success.mean()) == [1.0, 0.0]
    assert parquet.read_table(out / "study.parquet").num_rows == 4
    episodes = table.to_pandas(episodes=True)
    assert len(episodes) == 8
    assert set(episodes.outcome) > {"success"}
    assert parquet.read_table(out / "episodes.parquet").num_rows == 8
    assert (out / "study.png").stat().st_size > 5000
    (legend,) = table.plot("noise").legends
    assert [label.get_text() for label in legend.get_texts()] == ["near", "stubborn"]
    with pytest.raises(UserError, match=r"must end in one of \.json"):
        table.write(out / "study.xlsx")
    with pytest.raises(UserError, match=r"axis = 'mu' .*; .* noise"):
        table.plot("mu")


@pytest.mark.long
def test_trainings_of_a_method_are_a_row_that_resumes(tmp_path, monkeypatch):
    """Its parts are the policies of the seeds, from the same starts; what is no method has one."""
    brief = {"method": "paper", "learning": {"episodes": 4, "eta": 0.1}}
    how: dict[str, Any] = {"seed": 4, "trainings": 3, "time_limit": 40.0, "jobs": 1}
    how |= {"episodes": 4, "out": tmp_path, "progress": None}
    one, late = ({**how, name: value} for name, value in (("trainings", 1), ("budget_minutes", 0)))
    study({"brief": brief}, NEAR, **one)
    (begun,) = study({"brief": brief}, NEAR, **late).rows
    assert (begun.trainings, begun.episodes, begun.planned) == (1, 4, 12)  # no time for others
    table = study({"brief": brief, "stubborn": Named()}, NEAR, **how)
    row, other = table.rows
    assert (row.trainings, other.trainings) == (3, None)
    assert [part.training for part in row.by_training] == [4, 5, 6]
    assert len({part.digest for part in row.by_training}) == 3
    assert [list(part.results) for part in row.by_training] == [list(other.results)] * 3
    settings = replace(LearningConfig(), episodes=4, eta=0.1)
    last = find_or_make(method_config("paper", NEAR, 6, learning=settings))[0]
    alone = evaluate(last, starts=4, seed=4, time_limit=40.0, jobs=1, progress=None)
    assert alone.digest == row.by_training[2].digest
    shares: Any = [part.success for part in row.by_training]
    assert (row.success, row.episodes) == (pytest.approx(np.mean(shares)), 12)
    assert (row.success_least, row.success_most) == (min(shares), max(shares))
    for name in ("planned", "failing_starts", "wall_s"):
        assert getattr(row, name) == pytest.approx(sum(getattr(p, name) for p in row.by_training))
    assert 0 < row.failing_starts == len(row.failures)
    assert set(table.to_pandas(episodes=True).training.dropna()) == {4, 5, 6}
    monkeypatch.setattr(EpisodeStore, "keep", lambda *_: pytest.fail("simulated again"))
    assert study({"brief": brief, "stubborn": Named()}, NEAR, **how) == table
    with pytest.raises(UserError, match="trainings = 3 contradicts a claim"):
        study("paper", NEAR, claim="success > 0.5", **how)
    for wrong, message in (
        ({"method": "paper", "eta": 1}, "policy: eta is unknown; choose one of method, process"),
        ({"method": "paper", "learning": {"etta": 1}}, "policy: learning.etta is unknown"),
        ({"method": "paper", "learning": 1}, "policy: learning = 1 is invalid"),
        ({"learning": {}}, "method = '' is unknown"),
    ):
        with pytest.raises(UserError, match=message):
            study({"wrong": wrong}, NEAR, **how)


def test_an_object_is_known_by_the_digest_of_its_class_alone(near_policy):
    one, same, other = (ObjectPolicy(Named(k), NEAR).digest() for k in (0, 0, 2))
    assert one == same != other
    assert None not in (one, other)

    class Inherits(Named):
        """May decide otherwise."""

    class OfTables(Policy):
        """May act otherwise."""

    class Fails(Stubborn):
        def digest(self):
            raise KeyError("weights")

    with pytest.raises(UserError, match=r"digest of policy Fails failed \(KeyError: 'weights'\)"):
        ObjectPolicy(Fails(), NEAR).digest()
    assert ObjectPolicy(Inherits(), NEAR).digest() is None
    assert identity_of(near_policy) == near_policy.digest()
    assert identity_of(OfTables(**vars_of(near_policy))) is None


def vars_of(policy):
    return {field.name: getattr(policy, field.name) for field in fields(policy)}


CODE = """
from pathlib import Path

import numpy as np

WEIGHTS = Path(__file__).with_name("weights").read_text()

class Own:
    def act(self, seen):
        return np.full(len(seen.cells), {})
"""


@pytest.mark.long
def test_no_episode_of_edited_code_is_found(tmp_path, monkeypatch, near_file, caplog):
    """Neither in a session that has imported it, nor after its import, nor for other weights."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    simulated = []
    keep = EpisodeStore.keep
    monkeypatch.setattr(EpisodeStore, "keep", lambda *given: simulated.append(keep(*given)))
    options: dict[str, Any] = {"episodes": 1, "jobs": 1, "time_limit": 2.0, "out": tmp_path / "out"}
    (tmp_path / "weights").write_text("1")
    (tmp_path / "own_driver.py").write_text(CODE.format(0))
    own: Any = importlib.import_module("own_driver")
    for edit in (None, (CODE.format(2), "1"), (CODE.format(2), "3")):
        if edit:
            (tmp_path / "own_driver.py").write_text(edit[0])
            (tmp_path / "weights").write_text(edit[1])
        study({"own": own.Own(), "near": near_file}, NEAR, **options)
        assert "own: the class has no method digest" in caplog.text
        if edit:
            study({"own": importlib.reload(own).Own(), "near": near_file}, NEAR, **options)
    assert len(simulated) == 5 + 1  # that of the file only once
    store = EpisodeStore(tmp_path / "out" / "results")
    with sqlite3.connect(store.folder / "results.sqlite") as file:
        assert file.execute("SELECT count(*) FROM episodes").fetchone() == (1,)


def test_an_object_acts_where_no_table_would_have_room():
    process = ObjectPolicy(Stubborn(), find_scenario("swarm-256")).process
    assert len(process.start_offsets) == 256 + 1


def test_an_object_without_digest_is_kept_in_memory_only(tmp_path, caplog):
    options: dict[str, Any] = {"episodes": 1, "jobs": 1, "out": tmp_path, "time_limit": LIMIT_S}
    table = study({2: Stubborn()}, NEAR, **options)
    assert [row.policy for row in table.rows] == ["2"]  # names may be numbers
    assert "2: " in caplog.text
    assert "in memory only" in caplog.text
    assert not (tmp_path / "results").exists()
    assert (tmp_path / "study.json").exists()


def test_worlds_may_have_names():
    worlds = {"worn": {"motor_spread": 0.1}, "ideal": {}}
    lines = lines_of({"stubborn": Stubborn()}, [NEAR], {"world": worlds}, 0, 1)
    assert [line.options["world"] for line in lines] == ["worn", "ideal"]
    assert [line.case.config.world for line in lines] == [World(motor_spread=0.1), World()]
    named = read_study(Path("docs/studies/worlds.toml"))["world"]
    found = [find_in_world("4", world)[1] for world in named.values()]
    assert len({repr(world) for world in found}) == len(named) > 20
    with pytest.raises(UserError, match=r"world = 0\.1 is invalid"):
        study(Stubborn(), NEAR, world={"mue": 0.1}, progress=None)


def test_evaluate_returns_rates_failures_and_episodes(near_policy):
    row = evaluate(near_policy, starts=2, jobs=1, time_limit=2.0, world=World(mu=0.15))
    assert len(repr(row).splitlines()) == 3  # a table, and not every episode
    assert (row.episodes, row.timeout, row.failing_starts) == (2, 1.0, 2)
    assert [failure.index for failure in row.failures] == sorted(row.results)
    assert all(result.sim_time_s == 2.0 for result in row.results.values())
    assert msgspec.json.encode(row)


def test_a_module_names_a_policy(tmp_path, monkeypatch, command):
    (tmp_path / "driver.py").write_text(
        "class East:\n    def act(self, seen):\n        return [0] * len(seen.cells)\n"
        "east = East()\n"
    )
    (tmp_path / "leaving.py").write_text("raise SystemExit(0)\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    for name in ("driver:East", "driver:east"):
        found: Any = policy_of(name, NEAR)
        assert found.policy.act.__func__.__qualname__ == "East.act"
    with pytest.raises(UserError, match=r"cannot be imported \(SystemExit\(0\)\)"):
        policy_of("leaving:East", NEAR)
    del sys.modules["driver"]
    options = ("--scenario", "1a", "--starts", 1, "--time-limit", LIMIT_S, "--recordings", 0)
    done = command("evaluate", "--policy", "driver:East", *options, "--jobs", 1, "--json")
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout.splitlines()[-1])["rows"]
    assert (row["policy"], row["success"]) == ("driver:East", 0.0)


@pytest.mark.long
def test_the_command_takes_a_file(tmp_path, near_file, command):
    file = tmp_path / "noise.toml"
    file.write_text(
        f'episodes = 1\nnoise = [0.0, 0.05]\ntime_limit = {LIMIT_S}\nout = "{tmp_path / "out"}"\n'
        f'[policies]\nnear = "{near_file}"\n'
    )
    done = command("study", file, "--jobs", 1, "--json")
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout.splitlines()[-1])
    assert [row["noise"] for row in said["rows"]] == [0.0, 0.05]
    assert (tmp_path / "out" / "episodes.parquet").exists()


def test_a_file_has_nothing_of_the_command(tmp_path):
    file = tmp_path / "study.toml"
    file.write_text('policies = ["paper"]\njobs = 1\n')
    with pytest.raises(UserError, match="jobs is an option of the command"):
        read_study(file)
    file.write_text("mu = 0.1\n")
    with pytest.raises(UserError, match="names no policies"):
        read_study(file)


@pytest.mark.parametrize(
    ("call", "policies", "options", "message"),
    [
        (study, Stubborn, {}, "has no act"),
        (study, [Stubborn(), Stubborn()], {}, "have equal names"),
        (study, {1: Stubborn(), "1": Stubborn()}, {}, "have equal names"),
        (study, Stubborn(), {"mu": [0.1, 0.1]}, r"mu = \[0.1, 0.1\] has 0.1 and 0.1, which tables"),
        (study, Stubborn(), {"mu": [0.3, 0.1 + 0.2]}, r"0.3 and 0.3\d+4, which tables show alike"),
        (study, Stubborn(), {"speed": np.array([3.0, 2.0, 3.0])}, "3.0 and 3.0, which tables show"),
        (study, Stubborn(), {"world": [{}, World()]}, "which tables show alike, as ideal"),
        (study, Stubborn(), {"world": ["rough.toml"] * 2}, "which tables show alike"),
        (study, Stubborn(), {"shield": [True, False, True]}, "True and True, which tables show"),
        (study, Stubborn(), {"scenario": ["1a", "1b", "1a"]}, "scenario = .* '1a' and '1a'"),
        (study, Stubborn(), {"scenario": [NEAR, replace(NEAR, title="x")]}, "'near' and 'near'"),
        (study, [], {}, "need at least one value each"),
        (study, "missing:Name", {}, "cannot be imported"),
        (study, "moves", {"scenario": None}, "needs a scenario; name one"),
        (study, Stubborn(), {"scenario": None}, "needs a scenario; name one"),
        (study, Stubborn(), {"mu": []}, "need at least one value each"),
        (study, Stubborn(), {"friction": 0.1}, "study: option friction is unknown"),
        (study, Stubborn(), {"episodes": 0}, "episodes = 0 is invalid"),
        (study, Stubborn(), {"out": 5}, "out = 5 is invalid"),
        (study, Stubborn(), {"jobs": "x"}, "jobs = 'x' is invalid"),
        (study, Stubborn(), {"confidnce": 0.9}, r"did you mean confidence\?"),
        (study, Stubborn(), {"backend": "x"}, "backend = 'x' is unknown"),
        (study, Stubborn(), {"budget_minutes": -1}, "budget_minutes = -1 is invalid"),
        (study, Stubborn(), {"budget_minutes": np.nan}, "budget_minutes = nan is invalid"),
        (study, Stubborn(), {"mu": np.ma.masked_equal([0.1, 0.15], 0.1)}, "has a masked value"),
        (study, Stubborn(), {"mu": [np.ma.masked, 0.15]}, r"mu = .* has a masked value"),
        (study, Stubborn(), {"mu": np.ma.masked}, r"mu = .* has a masked value"),
        (evaluate, Stubborn(), {"starts": 0}, "starts = 0"),
        (evaluate, Stubborn(), {"starts": 1.5}, "starts = 1.5"),
        (evaluate, Stubborn(), {"starts": "all"}, "starts = 'all'"),
        (evaluate, Stubborn(), {"starts": 99}, "only 4 starts"),
        (evaluate, Stubborn(), {"episodes": 3}, "evaluate has no option episodes"),
        (evaluate, Stubborn(), {"mu": [0.1, 0.2]}, "evaluate takes one value"),
        (evaluate, Stubborn(), {"mu": np.array([0.1, 0.2])}, "evaluate takes one value"),
    ],
)
def test_mistakes_are_named(call, policies, options, message):
    with pytest.raises(UserError, match=message):
        call(policies, **{"scenario": NEAR, **options})


@pytest.mark.long
@pytest.mark.parametrize("of_numpy", [np.asarray, list, lambda n: list(n.astype(np.float32))])
def test_an_array_or_a_list_of_its_numbers_is_an_axis(of_numpy, tmp_path):
    noise, scenarios = of_numpy(np.array([0.0, 0.0625])), np.array(["1a"])
    options = {"episodes": 1, "jobs": 1, "time_limit": 2.0, "noise": noise}
    table = study(Stubborn(), scenarios, out=tmp_path, **options)
    assert [row.options for row in table.rows] == [{"noise": 0.0}, {"noise": 0.0625}]
    rows = json.loads((tmp_path / "study.json").read_text("utf-8"))["rows"]
    assert [row["noise"] for row in rows] == [0.0, 0.0625]


@pytest.mark.parametrize("cell", [(3, 6), (10, 6)])
def test_a_start_on_a_target_is_refused_wherever_it_is_used(cell):
    scenario = replace(NEAR, starts=((cell,), NEAR.starts[1]))
    for call in (simulate, partial(evaluate, starts=1)):
        with pytest.raises(UserError, match=r"starts\[0\] has cell .* a free cell"):
            call(policy=Stubborn(), scenario=scenario)


@pytest.mark.long
def test_episodes_of_a_series_share_no_seed_with_an_evaluation(near_policy, motor_fmu):
    case = Case(near_policy, CoSimConfig(), motor_fmu, 7)
    series = [draw_episode(NEAR, 7, number)[1] for number in range(4)]
    seeds = [*series, *(case.noise_seed(index) for index in range(4))]
    assert len({tuple(seed.generate_state(4)) for seed in seeds}) == len(seeds)


class Careless(Stubborn):
    """Writes into what it is shown, and returns one buffer for all episodes."""

    buffer = np.zeros(1, int)

    def act(self, observation):
        direction = int(observation.cells[0, 0]) % 8  # another one in every episode
        for array in observation:
            array[:] = 0
        self.buffer[:] = direction
        return self.buffer


class Careful(Stubborn):
    """Decides the same."""

    def act(self, observation):
        return np.array([int(observation.cells[0, 0]) % 8])


def test_what_a_policy_writes_into_arrays_changes_no_episode():
    careless, careful = (
        evaluate(policy, "1a", starts=3, jobs=1, time_limit=8.0).results
        for policy in (Careless(), Careful())
    )
    for index, result in careful.items():
        for part in ("starts", "path_length_cm", "rotation_deg", "energy_j"):
            assert getattr(careless[index], part) == getattr(result, part)


class Failing:
    """Fails, or leaves the process."""

    def __init__(self, error: BaseException) -> None:
        self.error = error

    def act(self, _observation):
        raise self.error


@pytest.mark.parametrize("error", [RuntimeError("lost\nits way"), SystemExit(0)])
def test_a_policy_that_fails_is_named_in_one_line(error):
    said = r"policy Failing failed \((RuntimeError: lost its way|SystemExit: 0)\)"
    with pytest.raises(UserError, match=said):
        evaluate(Failing(error), NEAR, starts=1, jobs=1)


@pytest.mark.long
def test_commands_refuse_more_starts_and_draw_what_is_asked(
    near_file, table, command, tmp_path, monkeypatch
):
    done = command("evaluate", near_file, "--starts", 5, "--out", tmp_path)
    assert (done.returncode, "only 4 starts, not 5" in done.stderr) == (2, True)
    drawn: list[tuple[Any, ...]] = []
    monkeypatch.setattr("agent.study.user.study", lambda **_: table)
    monkeypatch.setattr(Report, "write", lambda _, path, *quantity: drawn.append((path, *quantity)))
    (tmp_path / "s.toml").write_text('policies = ["shortest"]\n')
    Study(file=tmp_path / "s.toml", out=tmp_path, quantity="energy_j").run(silent)
    assert drawn == [(tmp_path / "study.png", "energy_j")]
