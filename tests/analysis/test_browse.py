"""A catalog of recorded episodes, as its server has it."""

import json
import shutil
import socket
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.catalog import CatalogClient

from analysis.browse import catalog
from analysis.browse.catalog import COLUMNS, serving
from cosim.model.config import CoSimConfig
from cosim.model.scenario_file import find_scenario
from cosim.recording.episode import EpisodeRecorder
from cosim.simulation.simulate import draw_episode
from cosim.simulation.tasks import Task, simulate_tasks

EPISODES = 3


class Down:
    """Sends every robot to the lower side."""

    def act(self, observation):
        return np.full(len(observation.cells), 6)


@pytest.fixture(scope="module")
def run(array_fmu, tmp_path_factory):
    """A folder with brief episodes of two scenarios, friction by number, and their results."""
    folder, results = tmp_path_factory.mktemp("run"), {}
    for name in ("1a", "2"):
        scenario = find_scenario(name)
        for number in range(EPISODES):
            config = CoSimConfig().with_overrides(0.1 + 0.01 * number, None)
            config = replace(config, timing=config.timing._replace(episode_limit_s=2.0))
            path = folder / name / "episodes" / f"ep_{number}.rrd"
            starts, seed = draw_episode(scenario, 0, number)

            def recorder(_, path=path, scenario=scenario, config=config, number=number):
                facts = {"scenario": scenario.name, "method": "paper", "episode": number}
                identity = f"{scenario.name}-{number}"
                return EpisodeRecorder(path, scenario, config, identity, facts, level="summary")

            task = Task(scenario, array_fmu, config, Down(), starts, seed, recorder)
            ((_, results[path]),) = simulate_tasks([task], 1)
    (folder / "1a" / "training.rrd").write_text("not of an episode")
    return folder, results


@pytest.mark.long
def test_every_episode_is_found_with_its_properties(run):
    folder, results = run
    with serving(folder) as datasets:
        assert [dataset.name for dataset in datasets] == ["1a-episodes", "2-episodes"]
        for dataset in datasets:
            # what any client of the catalog gets, not what this project has made of it
            address, _, number = dataset.address.rpartition("/dataset/")
            entry = CatalogClient(address).get_dataset(id=number)
            rows = entry.segment_table().to_arrow_table().to_pylist()
            assert len(rows) == len(dataset.episodes) == EPISODES
            assert entry.default_segment_table_blueprint() in entry.blueprints()
            assert entry.default_blueprint() in entry.blueprints()
            for row in rows:
                (file,) = row["rerun_storage_urls"]
                path = Path(file.removeprefix("file://"))
                (number,) = row[COLUMNS["episode"]]
                assert path.name == f"ep_{number}.rrd"
                assert row[COLUMNS["outcome"]] == [str(results[path].outcome)]
                assert row[COLUMNS["path_length_cm"]] == [results[path].path_length_cm]
                assert row[COLUMNS["energy_j"]] == [results[path].energy_j]
                assert row[COLUMNS["mu"]] == [0.1 + 0.01 * number]
                assert row[COLUMNS["method"]] == ["paper"]


def test_command_shows_the_table_and_what_was_left_out(command, run, tmp_path):
    folder, results = run
    shutil.copytree(folder / "2" / "episodes", tmp_path / "all")
    shutil.copyfile(tmp_path / "all" / "ep_0.rrd", tmp_path / "all" / "ep_9.rrd")
    (tmp_path / "all" / "broken.rrd").write_text("no recording")
    ended = command("browse", tmp_path, "--check", "--json")
    assert ended.returncode == 0, ended.stderr
    (dataset,) = json.loads(ended.stdout.splitlines()[-1])["datasets"]
    lengths = sorted(r.path_length_cm for p, r in results.items() if p.parts[-3] == "2")
    assert sorted(row["path_length_cm"] for row in dataset["episodes"]) == lengths
    left_out = [Path(file).name for file in dataset["left_out"]]
    assert left_out[0] == "broken.rrd"
    assert left_out[1] in {"ep_0.rrd", "ep_9.rrd"}
    assert all(row["outcome"] in ended.stdout for row in dataset["episodes"])
    assert "left out" in ended.stdout


def test_refusals(command, run, monkeypatch, tmp_path):
    nothing = command("browse", tmp_path, "--check")
    assert (nothing.returncode, len(nothing.stderr.splitlines())) == (2, 1)
    assert "no recordings" in nothing.stderr
    with socket.create_server(("127.0.0.1", 0)) as taken:
        busy = command("browse", run[0], "--port", taken.getsockname()[1])
    assert (busy.returncode, len(busy.stderr.splitlines())) == (2, 1)
    assert "another --port" in busy.stderr
    monkeypatch.setattr(catalog, "find_spec", lambda _name: None)
    lacking = command("browse", run[0], "--check")
    assert lacking.returncode == 2
    assert "--extra catalog" in lacking.stderr
