"""What commands print, write, draw and record in cases without symmetry, against files in `golden`.

A golden file says that something changed, not what is right: the closed forms, laws and independent
calculations of other tests do. Where an output is meant to change, look at the difference and write
the files with `GOLDEN=write uv run --group test pytest -m "ci or long" -k golden`.
"""

import shlex
from typing import Any

import gymnasium
import pytest

from agent.envs import WorldRange
from agent.training.methods import METHODS
from agent.web.compiler import Module
from tests.fingerprint import changes, fingerprint, leaves

LEG = """length_m = 0.01
axial_n_m = 1e4
bending_n_m = 12.0
lean_deg = 20.0
lean_towards_deg = 180.0
damping_ratio = 0.2
"""
FEET = [0.011, 0.019], [-0.022, 0.0], [0.011, -0.019]
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
    "pair.toml": """columns = 27
rows = 31
obstacles = [[3, 20, 5, 22]]
[[robots]]
target = [13, 15]
starts = [[8, 14, 9, 15]]
[[robots]]
target = [18, 9]
starts = [[20, 13], [22, 7]]
""",
    "touch.toml": """columns = 20
rows = 24
[[robots]]
target = [16, 12]
starts = [[6, 12]]
[[robots]]
target = [4, 10]
starts = [[13, 12]]
""",
    "near.toml": """columns = 30
rows = 30
[[robots]]
target = [10, 10]
starts = "top"
[[robots]]
target = [12, 12]
starts = "bottom"
""",
    "walled.toml": """columns = 20
rows = 24
obstacles = [[0, 12, 19, 12]]
[[robots]]
target = [10, 4]
starts = "top"
""",
    "turning.toml": "[body]\ndiameter_m = 0.02\n",
    "heavy.toml": "[body]\nmass_kg = 0.0003\nmasses_included = true\n",
    "soft.toml": "".join(f"[[foot]]\nplace_m = {place}\n{LEG}" for place in FEET),
    "mixed.toml": "".join(
        f"[[foot]]\nplace_m = {place}\n{LEG * (k > 0)}" for k, place in enumerate(FEET)
    ),
    "wrong.toml": 'policies = ["shortest"]\nscenario = "2"\nepisode = 3\n',
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
time_limit = 40
""",
    "map.toml": """policies = ["shortest"]
scenario = "1a"
rl_step = [2, 10, 1]
mu = [0.14, 0.2]
episodes = 1
time_limit = 20
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
    "study": [
        "study study.toml --jobs 1 --quantity energy_j --out OUT",
        "study map.toml --jobs 1 --quantity path_length_cm --out OUT/map",
    ],
    "train": [
        "train --scenario pair.toml --learning.episodes 6000 --learning.log-episodes 500 --runs 2 "
        "--seed 3 --jobs 1 --out OUT",
        "evaluate OUT/run_000/policy.npz OUT/run_001/policy.npz --grid",
        "run OUT/run_001/policy.npz --scenario pair.toml --time-limit 4 --out OUT/run",
        "experiments fig10 --runs 2 --episodes 3000 --jobs 1 --out OUT/fig10",
        "experiments fig08 --runs 3 --episodes 9000 --jobs 1 --out OUT/fig08",
    ],
    "page": [
        "web --scenario pair.toml --method shortest --seed 2 --worlds rough.toml --out OUT/a.html"
    ],
    "swarm": [
        "evaluate docs.examples.swarm:ThroughDoor --scenario docs/examples/door.toml --starts 1 "
        "--recordings 1 --time-limit 4 --seed 3 --jobs 1 --out OUT"
    ],
    "touch": [
        "evaluate docs.examples.greedy:Greedy --scenario touch.toml --starts 1 --recordings 1 "
        "--on-collision continue --noise 0.1 --time-limit 16 --seed 2 --jobs 1 --out OUT",
        "run --scenario touch.toml --method shortest --time-limit 4 --record full --out OUT/full",
        "run --scenario 1a --method shortest --mu 0.4 --time-limit 4 --out OUT/slow",
    ],
    "legs": [
        "run --scenario docs/examples/pogobots.toml --preset pogobot-brush --time-limit 4 --out OUT"
    ],
    "machine": [
        "design --speed 3.3 --preset icra2006",
        "design --speed 4",
        "platform --omega 620 --mu 0.21 --cycles 3 --out OUT/p.npz",
        "motor-loop --omega-des 640 --out OUT/loop.png",
        "motor-test --duration 0.4 --omega-des 610 --open-loop-v 1.1 --out OUT/motor.rrd",
        "draw hexbug droplet pogobot-brush --out OUT/machines.png",
        "calibrate --out OUT/calibration",
        "methods",
    ],
}

# What is refused with a message, before anything is computed
REFUSALS = """
run --scenario 2 --method nearest
run --scenario 1a --time-limit 7
run --scenario 1a --mu -0.1
run --scenario 1a --speed 9
run --scenario 1a --dt 3e-5
run --scenario 1a --communication-step 3e-5
run --scenario 1a --rl-step 0.0123
run --scenario 1a --preset nobot
run --scenario 1a --preset turning.toml
run --scenario 1a --preset heavy.toml
run --scenario 1a --preset soft.toml
run --scenario 1a --preset mixed.toml
run --scenario 1a --shield --open-loop heading
run --scenario 1a --motor-parameter J=0
run --scenario near.toml
run --scenario walled.toml
run --scenario 1a --episodes 0
run none.npz
evaluate nothing --scenario 2
evaluate shortest --scenario 2 --claim 'success > 2'
evaluate shortest --scenario 2 --claim 'success ='
evaluate shortest --scenario 2 --starts -3
evaluate shortest --scenario 2 --trainings 2
evaluate paper --scenario 2 --trainings 2 --claim 'success > 0.9'
study wrong.toml
study none.toml
train --scenario 2 --method shortest
train --scenario 2 --learning.epsilon 2
train --scenario 2 --learning.eta 0
train --scenario 2 --process.features x x
train --scenario 2 --method nearest
bound --scenario 2 --process.step-cost 3
design --speed 0
design --speed 3 --preset kilobot
platform --omega -1
platform --cycles 0
motor-test --duration 0
web --scenario 4-cross --seed 9007199254740993
web --scenario swarm-64
web --scenario 2 --worlds odd.toml
moves --moves 0
inspect odd.toml
inspect none.rrd
video none.rrd --out a.avi
compare none.rrd none.rrd
draw nobot
identify-robot none.csv
replay none.rrd
screenshot none.rrd
figures nothing
"""


@pytest.fixture(autouse=True)
def built_in_methods(monkeypatch):
    """Take away the methods that other tests have registered in this process."""
    for name in [name for name in METHODS if ":" in name]:
        monkeypatch.delitem(METHODS, name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory, request):
    folder = tmp_path_factory.mktemp("files")
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / "docs").symlink_to(request.config.rootpath / "docs")
    return folder


@pytest.fixture(scope="module")
def outcome(command, folder):
    """Run the lines of a case, and return all that they printed and wrote."""

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


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.long if name == "legs" else pytest.mark.ci)
        for name in CASES
    ],
)
def test_outputs_are_those_of_the_golden_file(name, outcome):
    assert not changes(name, outcome(name))


@pytest.mark.ci
def test_refusals_are_those_of_the_golden_file(command, folder, monkeypatch):
    monkeypatch.chdir(folder)
    found = {}
    for line in REFUSALS.strip().splitlines():
        done = command(*shlex.split(line))
        assert done.returncode == 2, line
        message = done.stderr[done.stderr.find("error: ") :]  # without what was begun before
        found[line.replace(" ", "_")] = message.replace(f"{folder}/", "")
    assert not changes("refusals", found)


@pytest.mark.ci
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
            {
                "scenario": "4",
                "observe": "estimated",
                "context": True,
                "worlds": WorldRange(payload_g=(4.0, 9.0), floor_tilt_deg=(0.3, 0.6)),
            },
        ),
        ("Pair", 2, {"scenario": "swarm-16", "render_mode": "ansi"}),
    ]
    for name, boards, how in cases:
        env = gymnasium.make_vec(f"MiniRobots/{name}-v0", num_envs=boards, **how)
        env.action_space.seed(3)
        steps = [env.reset(seed=4), *(env.step(env.action_space.sample()) for _ in range(5))]
        if "render_mode" in how:
            steps.append(("pictures", env.render()))
        env.close()
        for k, step in enumerate(steps):
            found |= leaves(f"{name}/{len(how)}/{k}", step)
    assert not changes("environments", found)
