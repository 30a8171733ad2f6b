"""Kernels compiled to WebAssembly have the bits of the same kernels in Python."""

import json
import math
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from agent.web import compiler
from agent.web.compiler import compiled
from agent.web.image import Image, image_of
from cosim.base.errors import UserError
from cosim.base.jit import kernel
from cosim.coupling.master import CompiledDriver, run_periods
from cosim.coupling.plant import Plant
from cosim.coupling.signals import RawSamples, Samples, State
from cosim.fmi.calls import Calls
from cosim.model.config import CoSimConfig
from cosim.model.params import SHIELD
from cosim.model.preset import find_preset
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.model.world import Patch, Sensor, World
from cosim.onboard.observing import draw_starts
from cosim.physics.lanes import Width, width_of
from cosim.simulation.batch import Batch

pytestmark = pytest.mark.browser
ROOT = Path(__file__).parents[3]
MACHINE = Path(compiler.__file__).with_name("page") / "machine.js"
FACING = Scenario("facing", "", ((15, 24), (15, 5)), (((15, 11),), ((15, 18),)))
ROUGH = World(motor_spread=0.1, sensor=Sensor(30.0, 50.0, 0.5, 1.0, 0.1))
PATCHED = World(floor_tilt_deg=1.0, mu_patches=(Patch((10, 8, 20, 13), 0.1),), edge=True)
PAIR = CoSimConfig(on_collision="continue")
DROPLET = find_preset("droplet")
# Calls kernels of a module, all from the same start, and writes the arrays after the last one.
CALLED = """
const fs = require("node:fs"), [code, folder, ...kernels] = process.argv.slice(1);
const Machine = new Function(fs.readFileSync(code, "utf8") + "return Machine")();
const layout = JSON.parse(fs.readFileSync("layout.json"));
const machine = new Machine(fs.readFileSync("kernels.wasm"), fs.readFileSync("image"), layout);
const results = kernels.map((kernel) => (machine.reset(), machine.call(kernel)));
for (const name of Object.keys(layout.arrays)) {
  const { values } = machine.array(name);
  fs.writeFileSync(name, new Uint8Array(values.buffer, values.byteOffset, values.byteLength));
}
console.log(JSON.stringify([results, machine.exports.memory.buffer.byteLength]));
"""


class Stretch(NamedTuple):
    """Arguments of `run_periods`."""

    plant: Plant
    state: State
    noise: np.ndarray
    samples: Samples
    raw: RawSamples
    calls: Calls
    width: Width


class Numbers(NamedTuple):
    """What kernels without motors take."""

    values: np.ndarray
    factor: float
    times: int


@kernel
def run(stretch: Stretch) -> int:
    """Simulate a stretch; return its fmi3Status."""
    return run_periods(*stretch)[0]


@kernel
def _products(values: np.ndarray, factor: float) -> np.ndarray:
    products = np.empty(len(values))
    for k in range(len(values)):
        products[k] = factor * values[k]
    return products


@kernel
def allocate(numbers: Numbers) -> int:
    """Make many small arrays."""
    for _ in range(numbers.times):
        numbers.values[:] = _products(numbers.values, numbers.factor)
    return len(numbers.values)


@kernel
def fail(numbers: Numbers) -> int:
    """Raise an error."""
    if numbers.factor > 0.0:
        raise ValueError("no")
    return 1


@kernel
def decay(numbers: Numbers) -> int:
    """Call a function of the C library."""
    return int(math.exp(numbers.factor))


class WatchingDriver(CompiledDriver):
    """Keeps the last stretch, and the memory before and after it."""

    last: tuple[Stretch, Image, Image]

    def advance(self, plant, state, noise, samples, raw):
        """See `Driver.advance`."""
        motors, width = self.motors, width_of(self.lanes)
        stretch = Stretch(plant, state, noise, samples, raw, motors.calls, width)
        assert motors.array is not None
        saved = np.frombuffer(motors.array.get_state(), dtype=np.uint8)
        before = image_of(stretch, motors=saved)
        super().advance(plant, state, noise, samples, raw)
        self.last = stretch, before, image_of(stretch)


def called(folder, module: bytes, image: Image, *kernels: str):
    """Call kernels in Node.js; return what they return, the memory's size, and arrays by name."""
    (folder / "kernels.wasm").write_bytes(module)
    (folder / "image").write_bytes(image.content)
    (folder / "layout.json").write_text(json.dumps(image.layout))
    command = ["node", "-e", CALLED, str(MACHINE), str(folder), *kernels]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    results, size = json.loads(done.stdout)
    return results, size, {name: (folder / name).read_bytes() for name in image.layout["arrays"]}


def simulated(fmu, policy, scenario, config) -> tuple[Stretch, Image, Image]:
    """Return the last RL step of a short episode, and the memory before and after it."""
    batch = Batch(fmu, config, scenario.robots, 1, lanes=min(2, scenario.robots))
    batch.driver = driver = WatchingDriver(batch.driver.motors, batch.driver.lanes)
    starts, seed = draw_starts(scenario, np.random.default_rng(3)), np.random.SeedSequence(3)
    episode, policy = batch.begin(0, scenario, starts, seed), policy(scenario.targets)
    for _ in range(6):  # of 200 000 ticks each
        if not episode.outcome:
            batch.advance({0: policy.act(episode.observation)})
    batch.close()
    return driver.last


def differing(arrays: dict[str, bytes], after: Image) -> list[str]:
    """Return the names of arrays that are not as Python left them."""
    content, layout = after
    places = {name: at for name, (at, *_) in layout["arrays"].items() if name != "calls.instances"}
    return [n for n, at in places.items() if arrays[n] != content[at : at + len(arrays[n])]]


@pytest.mark.parametrize(
    ("scenario", "config"),
    [
        pytest.param(FACING, PAIR, id="pair", marks=pytest.mark.slow),
        pytest.param(
            FACING,
            replace(PAIR, world=ROUGH, shield=SHIELD),
            id="rough",
            marks=pytest.mark.slow,
        ),
        pytest.param(find_scenario("1a"), PAIR, id="one", marks=pytest.mark.slow),
        pytest.param(FACING, replace(PAIR, world=PATCHED), id="slope", marks=pytest.mark.slow),
        pytest.param(FACING, replace(PAIR, reaction=True), id="reaction", marks=pytest.mark.slow),
        pytest.param(
            find_scenario("4-cross"),
            replace(PAIR, shield=SHIELD),
            id="four",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            DROPLET.board(find_scenario("2")),
            replace(DROPLET.config(), on_collision="continue"),
            id="droplet",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_stretch_has_the_bits_of_the_compiled_driver(
    array_fmu, straight_policy, tmp_path, scenario, config
):
    stretch, before, after = simulated(array_fmu, straight_policy, scenario, config)
    assert stretch.state.episodes.periods[0] >= 200
    module = compiled({"run": f"{__name__}:run"}, stretch)
    results, _, arrays = called(tmp_path, module.content, before, "run", "run")
    assert results == [0, 0]
    assert differing(arrays, after) == []


@pytest.mark.slow
def test_a_constant_of_a_kernel_changes_modules_and_python_alike(
    array_fmu, straight_policy, tmp_path
):
    copy, cache = tmp_path / "copy", tmp_path / "cache"
    for folder in ("agent", "analysis", "cosim", "fmus", "minirobots", "tests"):
        shutil.copytree(ROOT / folder, copy / folder)
    shutil.copy(ROOT / "pyproject.toml", copy)
    contact = copy / "cosim/physics/contact/rigid.py"
    text = contact.read_text("utf-8")
    assert "\nGAP_CORRECTION = 0.1\n" in text
    contact.write_text(text.replace("GAP_CORRECTION = 0.1", "GAP_CORRECTION = 0.12"), "utf-8")
    chosen = ["-m", "browser", "-k", "pair", "-n", "0", "-p", "no:cacheprovider"]
    places = {"PYTHONPATH": str(copy), "MINIROBOTS_CACHE": str(cache)}
    command = [sys.executable, "-m", "pytest", "tests/agent/web/test_compiler.py", *chosen]
    run = subprocess.run(
        command, cwd=copy, env=os.environ | places, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stdout
    (module,) = cache.glob("web/*.wasm")
    _, before, after = simulated(array_fmu, straight_policy, FACING, PAIR)
    _, _, arrays = called(tmp_path, module.read_bytes(), before, "run")
    assert "state.bodies.motion" in differing(arrays, after)


def test_arrays_that_kernels_make_are_freed_and_errors_are_raised(tmp_path):
    numbers = Numbers(np.arange(1000.0), 1.0, 100_000)
    module = compiled({name: f"{__name__}:{name}" for name in ("allocate", "fail")}, numbers)
    image = image_of(numbers)
    results, size, arrays = called(tmp_path, module.content, image, "allocate")
    assert results == [1000]
    assert size < 20_000_000  # of which 16 MB are the stack; all arrays together are 800 MB
    assert arrays["values"] == numbers.values.tobytes()
    with pytest.raises(AssertionError, match="fail failed"):
        called(tmp_path, module.content, image, "fail")


def test_what_a_c_library_would_compute_is_refused():
    numbers = Numbers(np.zeros(1), 1.0, 1)
    with pytest.raises(UserError, match="call exp of the C library"):
        compiled({"decay": f"{__name__}:decay"}, numbers)


def test_arrays_in_the_order_of_fortran_are_refused():
    with pytest.raises(TypeError, match="values is an array in Fortran's order"):
        image_of(Numbers(np.zeros((2, 3), order="F"), 1.0, 1))


def test_without_ziglang_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ziglang", None)  # as if it were not installed
    with pytest.raises(UserError, match="install the extra `build`"):
        compiled({"allocate": f"{__name__}:none"}, Numbers(np.zeros(1), 1.0, 1))
