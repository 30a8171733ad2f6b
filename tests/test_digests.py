"""Bits that a restructuring must not change: policies, moves, episodes and recordings, as hashes.

The expected hashes stand in `digests.json` next to this file, by what they are of, and with the
versions of what produced them. They hold on every machine. A hash says only that bits changed; the
places where robots end say how far. Where bits are meant to change, say so in CHANGELOG, raise
`VERSION` of each producer that they come from, so that stored results with the old bits are
computed again, and write the file with
`DIGESTS=write uv run --group test pytest -n 0 tests/test_digests.py`.
"""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from agent.evaluation.cases import Case, Job, run_jobs
from agent.evaluation.rows import measures
from agent.mdp.config import ProcessConfig
from agent.mdp.exact import joint_starts
from agent.moves.model import ObservedMoves
from agent.moves.observe import observe_moves
from agent.training.loop import learn
from agent.training.methods import METHODS, method_config
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.settings import LearningConfig
from cosim.calibration.measuring import find_calibration
from cosim.calibration.shielding import with_stopping_distance
from cosim.coupling.rl_step import Step, SupportsAct
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.model.world import Patch, Sensor, World
from cosim.onboard.observing import draw_starts
from cosim.recording.reader import read_episode
from cosim.simulation.batch import DRIVERS
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.result import EpisodeResult
from cosim.simulation.tasks import Record, Task, simulate_tasks
from fmus.build import cached_fmu

EXPECTED = Path(__file__).with_name("digests.json")
# Modules with the `VERSION` of what the hashes of each kind are of.
PRODUCERS = {
    "learning": ("agent.training.learning",),
    "moves": ("agent.moves.observe", "agent.training.learning", "agent.evaluation.cases"),
    "worlds": ("agent.evaluation.cases",),
    "calibration": ("cosim.calibration.measuring", "cosim.calibration.shielding"),
    "studies": ("agent.training.learning", "agent.evaluation.cases"),
    "computed": (
        "agent.moves.observe",
        "agent.mdp.optimum",
        "agent.moves.pair",
        "agent.moves.group",
    ),
}
# This processor as one of 2008, without fused multiply-add: for numba, for the C library, numpy and
# OpenBLAS.
OF_2008 = {
    "NUMBA_CPU_NAME": "nehalem",
    "NUMBA_CPU_FEATURES": "",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX512F,-AVX2,-AVX,-FMA,-FMA4",
    "NPY_DISABLE_CPU_FEATURES": "AVX2 FMA3 AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_ICL",
    "OPENBLAS_CORETYPE": "Nehalem",
}
LEARNERS = {
    "1a": ("1a", "paper"),
    "2": ("2", "paper"),
    "4": ("4", "paper"),
    "4 double Q": ("4", "double_q"),
}
END = "end of "  # before the name of an episode: places x, y, z in m where its robots end
CONFIG = CoSimConfig()
# Two robots that meet within 3 s, and two that come to a wall.
MEETING = Scenario("meeting", "", ((15, 5), (15, 24)), (((15, 18),), ((15, 12),)))
WALL = replace(MEETING, starts=(((15, 18),), ((15, 10),)), obstacles=((14, 14), (15, 14)))
CROSSING = find_scenario("4-cross")
# Targets one cell away: an episode takes some seconds.
NEAR = Scenario(
    "near", "", ((3, 6), (9, 6)), (((3, 7), (3, 8)), ((9, 5), (9, 4))), 13, 13, zone=(0, 0, 0, 0)
)
CAMERA = Sensor(30.0, 50.0, 0.5, 1.0, 0.1)
PATCHES = Patch((10, 8, 20, 13), 0.1), Patch((12, 16, 16, 20), 0.22)
WORLDS = {
    "ideal": World(),
    "patches": World(mu_patches=PATCHES),
    "unequal motors": World(motor_spread=0.1),
    "camera": World(sensor=CAMERA),
    "load": World(payload_g=5.0, payload_offset_mm=(4.0, -3.0), restitution=0.2),
    "all": World(
        mu_patches=PATCHES,
        motor_spread=0.1,
        restitution=0.1,
        floor_tilt_deg=1.0,
        payload_g=5.0,
        motor_phases_deg=(10.0, 200.0, 30.0, -40.0),
        sensor=CAMERA,
        edge=True,
    ),
}
THROUGH = {"through": True, "timing": CONFIG.timing._replace(rl_step_s=0.1)}
OPTIONS: dict[str, dict[str, Any]] = {
    "plain": {},
    "pushing on": {"on_collision": "continue"},
    "shield": {"shield": SHIELD},
    "through": THROUGH,
    "through with shield": THROUGH | {"shield": SHIELD},
    "open loops": {"open_loop": ("motors", "heading")},
    "reaction": {"reaction": True},
}


def _digest(*parts: Any) -> str:
    """Hash (16 hex digits) of arrays and of what JSON can hold."""
    found = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            found.update(
                f"{part.dtype}{part.shape}".encode() + np.ascontiguousarray(part).tobytes()
            )
        else:
            found.update(json.dumps(part, sort_keys=True).encode())
    return found.hexdigest()[:16]


def _of_policy(policy: Policy) -> str:
    return _digest(policy.q, policy.visits, policy.random, policy.episodes)


def _of_result(result: EpisodeResult) -> str:
    return _digest(msgspec.structs.asdict(result) | {"realtime_factor": None})


def _limited(config: CoSimConfig, limit_s: float) -> CoSimConfig:
    return replace(config, timing=config.timing._replace(episode_limit_s=limit_s))


def _of_learning() -> Iterator[tuple[str, str]]:
    for name, (scenario, method) in LEARNERS.items():
        config = method_config(method, scenario, episodes=4000)
        policy = learn(config)[0]
        yield f"policy {name}", _of_policy(policy)
        yield f"grid {name}", _digest(*policy.evaluate_on_grid())


def _on_moves(moves: ObservedMoves, scenario: str) -> Policy:
    features = ProcessConfig(features=("x", "y", "d", "g", "b"), step_limit=200)
    learning = LearningConfig(episodes=4000)
    config = PolicyConfig(find_scenario(scenario), features, learning, Seed(0), moves)
    return learn(config)[0]


def _of_moves(folder: Path) -> Iterator[tuple[str, str]]:
    stopping, through = (
        observe_moves(replace(CONFIG, **options), cached_fmu(), moves_per_kind=2)
        for options in ({}, THROUGH)
    )
    for name, moves in {"": stopping, " through": through}.items():
        rows = [[getattr(m, f) for f in m.__struct_fields__] for m in moves.moves]
        yield f"moves{name}", _digest(rows)
        yield f"policy 4 moves{name}", _of_policy(_on_moves(moves, "4"))
    yield "policy 4-cross moves", _of_policy(_on_moves(through, "4-cross"))
    yield from _of_recording(folder, _on_moves(through, "4"))


def _of_recording(folder: Path, policy: Policy) -> Iterator[tuple[str, str]]:
    path, scenario = folder / "episode.rrd", policy.config.scenario
    config = replace(CONFIG, timing=CONFIG.timing._replace(episode_limit_s=4.0, burst_s=0.01))
    start_seed, noise_seed = np.random.SeedSequence(0).spawn(2)
    starts = draw_starts(scenario, np.random.default_rng(start_seed))

    record = Record(path, {"episode": 0}, recording_id="digest")
    task = Task(scenario, cached_fmu(), config, policy, starts, noise_seed, record)
    ((_, result),) = simulate_tasks([task], 1)
    yield "episode", _of_result(result)
    for name, signal in sorted(read_episode(path).signals.items()):
        yield f"signal {name}", _digest(signal.time_s, signal.values)


def _traced(tasks: Mapping[str, Task]) -> Iterator[tuple[str, str]]:
    """Simulate episodes together: what becomes of each, and all that is sampled on the way."""
    traces: dict[str, list[Any]] = {name: [] for name in tasks}
    ends: dict[str, str] = {}

    def watched(name: str) -> Task:
        def watch(step: Step, _episode: RunningEpisode, _wall_s: float) -> None:
            traces[name] += [step.action, step.decided, step.completed, step.events]
            traces[name] += [np.asarray(signal) for signal in step.samples if signal.size]
            ends[name] = " ".join(f"{x:.9f}" for x in step.samples.position[-1].flat)

        return replace(tasks[name], watch=watch)

    results = dict(simulate_tasks([watched(name) for name in tasks], 1))
    for number, name in enumerate(tasks):
        yield name, _digest(_of_result(results[number]), *traces[name])
        yield f"{END}{name}", ends[name]


def _of_worlds(straight: Callable[..., SupportsAct]) -> Iterator[tuple[str, str]]:
    seed, fmu = np.random.SeedSequence(0), cached_fmu()

    def task(scenario: Scenario, limit_s: float, world: World, **options: Any) -> Task:
        config = _limited(replace(CONFIG, world=world, **options), limit_s)
        starts = tuple(cells[len(cells) // 2] for cells in scenario.starts)
        return Task(scenario, fmu, config, straight(scenario.targets), starts, seed)

    for name, options in OPTIONS.items():
        tasks = {f"{name}: {w}": task(MEETING, 3.0, WORLDS[w], **options) for w in WORLDS}
        tasks[f"{name}: wall"] = task(WALL, 3.0, WORLDS["patches"], **options)
        yield from _traced(tasks)
        alone = f"{name}: all"
        yield from _traced({f"{alone}, alone": tasks[alone]})
    for name in ("plain", "shield"):
        four = task(CROSSING, 3.0, WORLDS["camera"], **OPTIONS[name])
        yield from _traced({f"four robots, {name}": four})
    short = CONFIG.timing._replace(rl_step_s=0.01)
    for driver in DRIVERS:
        one = replace(task(MEETING, 0.01, WORLDS["unequal motors"], timing=short), driver=driver)
        yield from _traced({f"driver {driver}": one})


def _of_calibration() -> Iterator[tuple[str, str]]:
    config, fmu = replace(CONFIG, shield=SHIELD), cached_fmu()
    found = find_calibration(config, fmu)
    yield "calibration", _digest(*(getattr(found, f.name) for f in fields(found)))
    yield "shield", _digest(with_stopping_distance(config, fmu).shield)


def _of_computed() -> Iterator[tuple[str, str]]:
    moves = observe_moves(replace(CONFIG, **THROUGH), cached_fmu(), moves_per_kind=1)
    for robots in (1, 2):
        board = replace(NEAR, targets=NEAR.targets[:robots], starts=NEAR.starts[:robots])
        for method in ("shortest", "fastest", "planned"):
            partner = ("p",) if robots > 1 and method != "planned" else ()
            facing = () if method == "shortest" else ("h",)
            process = ProcessConfig(features=("x", "y", *facing, *partner))
            known = None if method == "shortest" else moves
            config = PolicyConfig(board, process, LearningConfig(), Seed(0), known, method)
            compute = METHODS[method].compute
            assert compute is not None
            policy = compute(config)
            evaluation = policy.evaluate_on_grid(joint_starts(policy.process)[:8])
            yield (
                f"{method} {robots}",
                _digest(*(getattr(policy, name) for name in policy.array_names()), *evaluation),
            )


def _of_studies() -> Iterator[tuple[str, str]]:
    learner = PolicyConfig(NEAR, ProcessConfig(), LearningConfig(episodes=5000), Seed(0))
    config = _limited(replace(CONFIG, world=WORLDS["unequal motors"]), 6.0)
    case = Case(learn(learner)[0], config, cached_fmu(), 0)
    yield "sample", _digest(case.sample(4), case.rounds(50))
    rows = {job.index: result for job, result in run_jobs([Job(case, k) for k in range(4)], 1)}
    for index, result in sorted(rows.items()):
        yield f"row {index}", _of_result(result)
    report = msgspec.to_builtins(measures([(case, rows)]))
    # without intervals, which special functions of a library give
    kept = {k: v for k, v in report.items() if not k.endswith(("_low", "_high"))}
    yield "summary", _digest(kept)


def _moved(found: dict[str, str], known: dict[str, str]) -> str:
    """Say by how much ends differ that both have, in µm."""
    far = {}
    for name in found.keys() & known.keys():
        if name.startswith(END):
            one, other = (np.array(of[name].split(), dtype=float) for of in (found, known))
            far[name] = np.abs(one - other).max()
    worst = max(far, key=far.__getitem__, default=None)
    return f"; at most {1e6 * far[worst]:.3g} µm, at the {worst}" if worst else ""


def check(kind: str, found: dict[str, str], file: Path) -> None:
    """Compare hashes with those in a file; write them instead if `DIGESTS` says so."""
    expected = json.loads(file.read_text("utf-8"))
    versions = {name: import_module(name).VERSION for name in PRODUCERS[kind]}
    known = expected["versions"].get(kind)
    of_kind = expected.get(kind, {})
    differing = [name for name in found if found[name] != of_kind.get(name, found[name])]
    if differing and versions == known:
        producers = " or ".join(PRODUCERS[kind])
        pytest.fail(
            f"bits changed ({', '.join(differing)}{_moved(found, of_kind)}): raise VERSION of "
            f"{producers} and write the digests again"
        )
    if os.environ.get("DIGESTS") == "write":
        expected[kind], expected["versions"][kind] = found, versions
        file.write_text(json.dumps(expected, indent=2) + "\n", encoding="utf-8")
        return
    assert versions == known, "VERSION changed: write the digests again"
    assert found.keys() == expected[kind].keys()


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=() if kind in ("learning", "studies") else pytest.mark.ci)
        for kind in sorted(PRODUCERS)
    ],
)
def test_bits_are_those_committed(kind, tmp_path, straight_policy, monkeypatch):
    monkeypatch.setattr("agent.moves.observe.WALKS", 2)
    made = {
        "learning": _of_learning,
        "moves": lambda: _of_moves(tmp_path),
        "worlds": lambda: _of_worlds(straight_policy),
        "calibration": _of_calibration,
        "studies": _of_studies,
        "computed": _of_computed,
    }[kind]
    check(kind, dict(made()), EXPECTED)


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param(kind, marks=pytest.mark.long if kind == "studies" else pytest.mark.slow)
        for kind in sorted(PRODUCERS)
    ],
)
def test_another_processor_gives_the_same_bits(kind):
    test = f"{__file__}::test_bits_are_those_committed[{kind}]"
    command = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-m", "", test]
    env = os.environ | OF_2008
    ended = subprocess.run(command, check=False, env=env, capture_output=True, text=True)
    assert "1 passed" in ended.stdout, ended.stdout + ended.stderr
