"""One case gives one episode by every way in."""

import json
from typing import Any

import msgspec
import pytest

import agent
import minirobots as mr
from agent.envs import parallel_env
from agent.training.methods import method_config
from agent.web.page import write_page
from cosim.base.errors import UserError
from cosim.recording.series import DIRECTION_NAMES
from cosim.simulation.options import Physics, SimulationOptions
from cosim.simulation.simulate import draw_episode
from cosim.simulation.tasks import Task, simulate_tasks
from tests.minirobots.test_doors import ALONE, WALL, flags


@pytest.mark.long
def test_every_way_in_gives_the_same_episode(command, tmp_path, monkeypatch):
    """Without noise, so that what each way in draws makes no difference."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "board.toml").write_text(ALONE)
    (tmp_path / "world.toml").write_text(WALL.replace("motor_spread = 0.02", ""))
    board, options = tmp_path / "board.toml", {"world": tmp_path / "world.toml", "noise": 0.0}
    episode = mr.simulate(
        board, mr.train(board, world=options["world"], method="shortest"), **options
    )
    actions = episode.texts["/rl/r1/action"].texts
    expected = "success", episode.time_s
    on = ("--scenario", board, *flags(options))
    assert command("run", *on, "--method", "shortest", "--out", "run").returncode == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    rows = [mr.evaluate("shortest", board, starts=1, **options)]
    rows += mr.study("shortest", board, episodes=1, **options).rows
    results = [msgspec.to_builtins(result) for row in rows for result in row.results.values()]
    ended = command("evaluate", "shortest", *on, "--json")
    (row,) = json.loads(ended.stdout.splitlines()[-1])["rows"]
    length_cm, *lengths_cm = (
        one["path_length_cm"] for one in (*summary["episodes"], *results, row)
    )
    assert lengths_cm == [length_cm] * len(lengths_cm)
    times_s = [one["sim_time_s"] for one in (*summary["episodes"], *results, row)]
    assert (*{*times_s}, *{one["outcome"] for one in results}) == expected[::-1]
    environment = parallel_env(board, cosim=True, decision="period", **options)
    environment.reset(seed=0)
    infos: Any = None
    for action in actions:
        *_, infos = environment.step({"robot_1": DIRECTION_NAMES.index(action)})
    assert infos["robot_1"]["is_success"]
    assert round(infos["robot_1"]["path_length"], 6) == length_cm
    played = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("agent.web.page._world", lambda *given: played.append(given) or {})
        patch.setattr("agent.web.page._html", lambda *_: b"")
        write_page(tmp_path / "p.html", board, SimulationOptions(**options), method="shortest")
    ((_, policy, setup, seed),) = played
    starts, noise = draw_episode(setup.scenario, seed, 0)
    tasks = [Task(setup.scenario, setup.fmu, setup.config, policy, starts, noise)]
    ((_, result),) = simulate_tasks(tasks, 1)
    assert (result.outcome, result.sim_time_s, result.path_length_cm) == (*expected, length_cm)


@pytest.mark.long
def test_a_policy_names_the_machine_of_its_moves_and_warns_on_another(
    command, tmp_path, monkeypatch, caplog
):
    monkeypatch.setattr("cosim.calibration.measuring.calibrated", lambda config, *_, **__: config)
    (path := tmp_path / "alone.toml").write_text(ALONE)
    agent.train(path, method="fastest", progress=None).save(file := tmp_path / "policy.npz")
    policy = agent.load(file)
    moves = policy.config.moves
    assert moves.machine == "paper (VibrationMotors.fmu)"
    short: Any = {"time_limit": 2, "progress": None}
    on = "--policy", file, "--scenario", path, "--time-limit", 2, "--record", "none"
    cases: Any = ({}, False), ({"mu": 0.2}, False), ({"motor_parameters": {"J": 6e-9}}, True)
    for options, foreign in cases:
        out = tmp_path / f"run-{len(caplog.text)}-{foreign}"
        for way in (
            lambda o=options: mr.simulate(path, policy, record="summary", **short, **o),
            lambda o=options: mr.evaluate(policy, path, starts=1, **short, **o),
            lambda o=options, out=out: command("run", *on, *flags(o), "--out", out),
        ):
            caplog.clear()
            way()
            assert ("made with moves of machine paper" in caplog.text) == foreign
    with pytest.raises(UserError, match=r"those of machine paper .* do not fit kilobot"):
        method_config("moves", path, options=Physics(preset="kilobot"), moves=moves)
    assert method_config("moves", path, moves=moves, alone=True).moves == moves
