"""Training recordings: maps at several moments, mean and scatter over runs, no empty views."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from agent.mdp.config import ProcessConfig
from agent.training.learning import map_points
from agent.training.loop import learn
from agent.training.policy import PolicyConfig, Seed
from agent.training.recording import joined, write_runs, write_training
from agent.training.runs import RECORDING_FILE, RunsConfig, make_runs
from agent.training.settings import LearningConfig
from agent.training.store import POLICY_FILE
from cosim.base.jobs import Workers
from cosim.model.scenario_file import find_scenario
from cosim.recording.blueprint import training_blueprint
from cosim.recording.reader import read_rrd

LEARNING = LearningConfig(episodes=4000, epsilon_episodes=10, greedy_points=5)


def columns(path, entity: str, component: str) -> tuple[np.ndarray, list]:
    """Episodes and values of a component of an entity."""
    episodes, values = [], []
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        names = [n for n in batch.schema.names if n.endswith(component)]
        if chunk.entity_path == entity and names and "episode" in batch.schema.names:
            episodes += batch.column("episode").to_pylist()
            values += batch.column(names[0]).to_pylist()
    return np.array(episodes), values


@pytest.fixture(scope="module")
def trained():
    scenario, process = find_scenario("2"), ProcessConfig()
    return [learn(PolicyConfig(scenario, process, LEARNING, Seed.of(seed))) for seed in range(3)]


@pytest.fixture(scope="module")
def recordings(trained, tmp_path_factory):
    folder = tmp_path_factory.mktemp("training")
    policy, log = trained[0]
    write_training(folder / "one.rrd", policy, log, {"seed": 0})
    write_runs(folder / "all.rrd", [log for _, log in trained], {"seed": 0})
    return folder


@pytest.mark.parametrize(("name", "robots"), [("one.rrd", 2), ("all.rrd", 0)])
def test_every_path_of_the_blueprint_is_recorded(recordings, shown_paths, name, robots):
    entities = {chunk.entity_path for chunk in RrdReader(str(recordings / name)).stream()}
    paths = shown_paths(training_blueprint(robots))
    assert len(paths) == 6 + 3 * robots
    assert paths <= entities


def test_maps_are_those_of_the_tables_at_their_time(trained, recordings):
    policy, log = trained[0]
    assert log.map_episode.tolist() == [800, 1600, 3200, 4000]  # early ones, and the last
    assert map_points(LearningConfig()).tolist() == [0, 1, 3, 7, 15, 31, 49]
    assert map_points(LearningConfig(greedy_points=0)).tolist() == []
    assert np.array_equal(log.maps[-1], np.array(policy.maps(), dtype=np.float32))
    assert (np.diff(log.maps[:, :, 2].sum(axis=(1, 2, 3))) > 0).all()  # visits
    for entity in ("value_map", "visits"):
        episodes, images = columns(recordings / "one.rrd", f"/q/r2/{entity}", "Image:buffer")
        assert episodes.tolist() == log.map_episode.tolist()
        assert len({bytes(np.concatenate(image)) for image in images}) == len(images)


def test_arrows_point_where_robots_go_in_pictures_with_y_downwards(trained, recordings):
    policy, _ = trained[0]
    maps = policy.maps()[1]
    cells = np.argwhere(maps.visits > 0)
    angles = 0.25 * np.pi * maps.action[maps.visits > 0]
    found = [
        columns(recordings / "one.rrd", "/q/r2/policy", f"Arrows2D:{name}")[1][-1]
        for name in ("vectors", "origins")
    ]
    vectors, origins = map(np.array, found)
    lengths = np.linalg.norm(vectors, axis=1)
    along = np.column_stack([np.cos(angles), -np.sin(angles)])
    assert vectors == pytest.approx(lengths[:, None] * along, abs=1e-6)
    middle = np.column_stack([cells[:, 0] + 0.5, maps.visits.shape[1] - cells[:, 1] - 0.5])
    assert origins + 0.5 * vectors == pytest.approx(middle, abs=1e-5)


def test_maps_have_a_colour_bar_with_its_ends(trained, recordings):
    policy, _ = trained[0]
    value, _, visits = policy.maps()[1]
    _, labels = columns(recordings / "one.rrd", "/q/r2/value_map/scale", "Points2D:labels")
    known = value[visits > 0]
    assert labels[-1] == [f"{known.max():.3g}", f"{known.min():.3g}"]


def test_the_end_of_exploration_is_marked(trained, recordings):
    _, log = trained[0]
    end = np.flatnonzero(log.epsilon == log.epsilon.min())[0]
    for curve, values in (("success", log.success), ("epsilon", log.epsilon)):
        path = f"/train/{curve}/exploration_end"
        episodes, marked = columns(recordings / "one.rrd", path, "Scalars:scalars")
        assert episodes.tolist() == [log.episode[end]]
        assert marked == [[values[end]]]


def test_runs_are_shown_by_mean_and_variance(trained, recordings):
    logs = [log for _, log in trained]
    path = recordings / "all.rrd"
    episodes, means = columns(path, "/train/greedy/success", "Measurements:values")
    _, variances = columns(path, "/train/greedy/success", "Measurements:variances")
    table = np.array([log.greedy_success for log in logs])
    assert episodes.tolist() == logs[0].greedy_episode.tolist()
    assert np.ravel(means) == pytest.approx(table.mean(axis=0))
    assert np.ravel(variances) == pytest.approx(table.var(axis=0, ddof=1))


def test_runs_are_joined_where_all_have_a_value(trained):
    log = trained[0][1]
    holes = log._replace(path_length_cm=np.where(log.episode == 2000, np.nan, 1.0))
    late = log._replace(episode=log.episode[1:], path_length_cm=np.ones(len(log.episode) - 1))
    episode, table = joined([holes, late], "episode", "path_length_cm")
    assert episode.tolist() == [3000, 4000]
    assert table.tolist() == [[1.0, 1.0], [1.0, 1.0]]


def test_maps_are_seen_whole_with_their_colour_bars():
    def maps_in(part: Any) -> Iterator[Any]:
        if isinstance(part, rrb.Spatial2DView):
            yield part
        elif not isinstance(part, str):
            for inner in part.contents or ():
                yield from maps_in(inner)

    maps = [*maps_in(training_blueprint(2, 30, 20).root_container)]
    assert len(maps) == 6
    for view in maps:
        (seen,) = view.properties["VisualBounds2D"].range.as_arrow_array().to_pylist()
        assert seen == {"x_range": [-1.0, 36.0], "y_range": [-2.0, 22.0]}


def test_a_run_that_is_trained_later_says_which_one_it_is(tmp_path):
    common = RunsConfig(find_scenario("1a"), ProcessConfig(), LEARNING, 0, 3)
    make_runs(common, tmp_path, where=Workers(jobs=1))
    (tmp_path / "run_001" / POLICY_FILE).unlink()
    make_runs(common, tmp_path, where=Workers(jobs=1))
    for number in range(3):
        facts = read_rrd(tmp_path / f"run_{number:03d}" / RECORDING_FILE).properties["training"]
        assert (facts["run"], facts["seed"]) == (number, 0)
