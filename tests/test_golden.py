"""What commands print, write, draw and record in cases without symmetry, against files in `golden`.

A golden file says that something changed, not what is right: the closed forms, laws and independent
calculations of other tests do. Where an output is meant to change, look at the difference and write
the files with `GOLDEN=write uv run --group test pytest -m long -k golden`.
"""

import shlex
from typing import Any

import gymnasium
import pytest

from agent.envs import WorldRange
from agent.web.compiler import Module
from tests.fingerprint import changes, fingerprint, leaves

pytestmark = pytest.mark.long
FILES = {
    "odd.toml": """title = "an odd board"
columns = 34
rows = 26
zone = [20, 5, 29, 21]
obstacles = [[14, 20, 16, 22], [9, 3]]
[[robots]]
target = [24, 17]
starts = [[20, 18], [20, 19]]
[[robots]]
target = [25, 7]
starts = [[21, 4], [29, 6]]
[[robots]]
target = [9, 12]
starts = [[12, 13]]
""",
    "pair.toml": """columns = 31
rows = 27
obstacles = [[3, 20, 5, 22]]
[[robots]]
target = [13, 15]
starts = [[8, 14, 9, 15]]
[[robots]]
target = [18, 9]
starts = [[20, 13], [22, 7]]
""",
    "rough.toml": """[world]
mu = 0.17
mu_patches = [{cells = [4, 4, 22, 14], mu = 0.21}]
motor_spread = 0.04
floor_tilt_deg = 0.3
[world.sensor]
rate_hz = 25
delay_ms = 60
position_noise_mm = 0.4
heading_noise_deg = 0.8
dropout = 0.1
""",
    "study.toml": """policies = ["paper", "shortest"]
scenario = ["pair.toml", "1a"]
mu = [0.14, 0.2]
trainings = 2
episodes = 3
time_limit = 14
""",
}
DRIVE = "--world rough.toml --seed 5 --jobs 1"
# Command lines of a case, one after the other in the folder of FILES; OUT is its own folder.
CASES = {
    "group": [
        f"run --scenario odd.toml --episodes 2 --time-limit 22 {DRIVE} --out OUT",
        "inspect OUT/episodes/ep_000.rrd --parameters",
        "export OUT/episodes/ep_001.rrd --to csv --rate 7 --out OUT/b.csv",
        "video OUT/episodes/ep_001.rrd --speed 9 --out OUT/b.gif",
        "compare OUT/episodes/ep_000.rrd OUT/episodes/ep_001.rrd --out OUT/both.png",
        "replay OUT/episodes/ep_001.rrd",
    ],
    "pair": [
        "evaluate shortest fastest --scenario pair.toml --starts 3 --recordings 1 --time-limit 18 "
        "--through --shield --mu 0.16 --speed 3.1 --seed 4 --jobs 1 --out OUT",
        "bound --scenario pair.toml --process.collision swept",
    ],
    "study": ["study study.toml --jobs 1 --quantity energy_j --out OUT"],
    "train": [
        "train --scenario pair.toml --learning.episodes 6000 --learning.log-episodes 500 --runs 2 "
        "--seed 3 --jobs 1 --out OUT",
        "evaluate OUT/run_000/policy.npz OUT/run_001/policy.npz --grid",
        "experiments fig10 --runs 2 --episodes 3000 --jobs 1 --out OUT/fig10",
    ],
    "page": [
        "web --scenario pair.toml --method shortest --seed 2 --worlds rough.toml --out OUT/a.html"
    ],
    "swarm": [
        "evaluate docs.examples.swarm:ThroughDoor --scenario docs/examples/door.toml --starts 1 "
        "--recordings 1 --time-limit 4 --seed 3 --jobs 1 --out OUT"
    ],
    "legs": [
        "run --scenario docs/examples/pogobots.toml --preset pogobot-brush --time-limit 4 --out OUT"
    ],
    "machine": [
        "design --speed 3.3 --preset icra2006",
        "platform --omega 620 --mu 0.21 --cycles 3 --out OUT/p.npz",
        "motor-loop --omega-des 640 --out OUT/loop.png",
        "motor-test --duration 0.4 --omega-des 610 --open-loop-v 1.1 --out OUT/motor.rrd",
        "draw hexbug droplet pogobot-brush --out OUT/machines.png",
        "calibrate --out OUT/calibration",
        "methods",
    ],
}


@pytest.fixture(scope="module")
def outcome(command, tmp_path_factory, request):
    """Run the lines of a case, and return all that they printed and wrote."""
    folder = tmp_path_factory.mktemp("files")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / "docs").symlink_to(request.config.rootpath / "docs")

    def run(name: str) -> dict[str, Any]:
        where, printed = folder / name, []
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            # Kernels of pages are compiled by other tests, for a minute
            patch.setattr("agent.web.page.compiled", lambda *_: Module("none", b""))
            patch.syspath_prepend(folder)
            for line in CASES[name]:
                first, *rest = shlex.split(line.replace("OUT", name))
                done = command(first, *rest, "--json")
                assert done.returncode in (0, 1), done.stderr
                printed.append(done.stdout.replace(f"{folder}/", ""))
        return fingerprint(where, "\n".join(printed))

    return run


@pytest.mark.parametrize("name", CASES)
def test_outputs_are_those_of_the_golden_file(name, outcome):
    assert not changes(name, outcome(name))


def test_environments_are_those_of_the_golden_file():
    """Every row and every value of some steps."""
    found: dict[str, Any] = {}
    cases: list[tuple[str, int, dict[str, Any]]] = [
        ("SingleB", 2, {}),
        ("Pair", 2, {}),
        ("CoSimPair", 1, {"mu": 0.17}),
        (
            "Drive",
            2,
            {"scenario": "4", "observe": "estimated", "worlds": WorldRange(mu=(0.1, 0.2))},
        ),
    ]
    for name, boards, how in cases:
        env = gymnasium.make_vec(f"MiniRobots/{name}-v0", num_envs=boards, **how)
        env.action_space.seed(3)
        steps = [env.reset(seed=4), *(env.step(env.action_space.sample()) for _ in range(5))]
        env.close()
        for k, step in enumerate(steps):
            found |= leaves(f"{name}/{k}", step)
    assert not changes("environments", found)
