"""The package as others install it: what the wheel holds, and work without the checkout."""

import io
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from fmus.compiler import host_target
from fmus.models import MODELS
from tests.alone import python

pytestmark = pytest.mark.long
ROOT = Path(__file__).parents[1]
PACKAGES = ("fmus", "cosim", "agent", "analysis", "minirobots")
BUILT = {f"fmus/built/{model}.fmu" for model in MODELS}
SESSION = """
import hashlib, agent, analysis, cosim, minirobots
policy = minirobots.train("1a", method="paper", episodes=20_000)
policy.save("policy.npz")
episode = cosim.simulate("1a", agent.load("policy.npz"), time_limit=4.0)
episode.save("episode.rrd")
bits = hashlib.sha256()
for name, signal in sorted(episode.signals.items()):
    bits.update(name.encode() + signal.values.tobytes())
print(bits.hexdigest(), analysis.open("episode.rrd").outcome)
print(*(p.__file__ for p in (agent, analysis, cosim)))
"""


TYPED = """
import minirobots as mr
reveal_type(mr.train("1a", method="paper"))
reveal_type(mr.simulate("1a", mr.load("policy.npz")).outcome)
reveal_type(mr.open("a.rrd").time_s)
reveal_type(mr.World(mu=0.2).mu)
reveal_type(mr.evaluate("moves", "1a", starts=4, mu=0.1).success)
reveal_type(mr.study(["moves"], "1a", mu=[0.1, 0.2]).to_markdown())
mr.simulate()
"""


# What is carried sooner than all.
FEWER = {"MINIROBOTS_WHEEL_TARGETS": host_target(), "MINIROBOTS_WHEEL_PAGES": "4/shortest"}


def build(out: Path, kind: str, fewer: dict[str, str]) -> Path:
    """A wheel or an sdist."""
    command = ["uv", "build", f"--{kind}", "--quiet", "--out-dir", out]
    subprocess.run(command, cwd=ROOT, env=os.environ | fewer, check=True)
    (path,) = (path for path in out.iterdir() if path.suffix in {".whl", ".gz"})
    return path


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    return build(tmp_path_factory.mktemp("wheel"), "wheel", FEWER)


def test_wheel_holds_every_file_of_the_packages_and_no_other(wheel):
    tracked = subprocess.run(
        ["git", "ls-files", *PACKAGES], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.splitlines()
    there = {name for name in tracked if (ROOT / name).is_file()}
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        carried = [zipfile.ZipFile(io.BytesIO(archive.read(name))) for name in BUILT]
    (page,) = (name for name in names if name.endswith(".wasm"))
    assert page.startswith("cosim/packaged/web/")
    assert names == there | BUILT | {page, f"{page}.sha256"}
    for fmu in carried:
        assert any(name.startswith(f"binaries/{host_target()}/") for name in fmu.namelist())


def test_pyright_sees_the_types_of_an_installed_wheel(wheel, tmp_path):
    installed = tmp_path / "environment" / "bin" / "python"
    for command in (
        ["uv", "venv", "--quiet", "--python", sys.executable, tmp_path / "environment"],
        ["uv", "pip", "install", "--quiet", "--no-deps", "--python", installed, wheel],
    ):
        subprocess.run(command, cwd=ROOT, check=True)
    (tmp_path / "mine.py").write_text(TYPED)
    options = ("--outputjson", "--pythonpath", installed, "mine.py")
    done = python("-m", "pyright", *options, cwd=tmp_path)
    said = json.loads(done.stdout)["generalDiagnostics"]
    types = [row["message"].split(" is ")[-1] for row in said if row["severity"] == "information"]
    expected = "GreedyPolicy", "str", "float", "float | None", "float | None", "str"
    assert types == [f'"{name}"' for name in expected]
    (error,) = (row["message"] for row in said if row["severity"] == "error")
    assert '"scenario"' in error


@pytest.fixture(scope="module")
def packages(tmp_path_factory) -> dict[str, Path]:
    """What others install: a wheel for all platforms, and an sdist."""
    folder = tmp_path_factory.mktemp("packages")
    return {kind: build(folder / kind, kind, {}) for kind in ("wheel", "sdist")}


@pytest.fixture(scope="module")
def found() -> dict[str, str]:
    """What the first installation has found."""
    return {}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "version"), [("wheel", "3.11"), ("wheel", "3.12"), ("wheel", "3.13"), ("sdist", None)]
)
def test_installed_package_works_without_the_checkout_and_a_compiler(
    kind, version, packages, found, tmp_path
):
    """In an environment, a cache and a folder in which nothing is yet; same bits everywhere.

    uv must find (or fetch) the three interpreters.
    """
    environment, work = tmp_path / "environment", tmp_path / "work"
    work.mkdir()
    interpreter = environment / "bin" / "python"
    package = packages[kind]
    # in the checkout, whose pyproject.toml has the tested versions
    for command in (
        ["uv", "venv", "--quiet", "--python", version or sys.executable, environment],
        ["uv", "pip", "install", "--quiet", "--python", interpreter, package],
    ):
        # FEWER for what is built from the sdist
        subprocess.run(command, cwd=ROOT, env=os.environ | FEWER, check=True)
    own = {name: v for name, v in os.environ.items() if name not in {"PYTHONPATH", "VIRTUAL_ENV"}}
    own |= {"MINIROBOTS_CACHE": str(tmp_path / "cache"), "PATH": str(environment / "bin")}

    def run(*command: Path | str) -> str:
        done = subprocess.run(
            command, cwd=work, env=own, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    brief = ("--scenario", "1a", "--method", "paper", "--train-episodes", "20000")
    text = run(environment / "bin" / "minirobots", "run", *brief, "--time-limit", "4")
    assert "timeout" in text
    (recording,) = work.glob("runs/1a-*/episodes/ep_000.rrd")
    assert recording.stat().st_size > 100_000
    size = json.loads(run(environment / "bin" / "minirobots", "web", "--json").splitlines()[-1])
    assert size["bytes"] == (work / "page.html").stat().st_size > 100_000
    bits, outcome, *files = run(interpreter, "-c", SESSION).split()
    assert found.setdefault("bits", bits) == bits
    assert outcome == "timeout"
    assert all(Path(file).is_relative_to(environment) for file in files)
    files = {path.name for path in work.iterdir()}
    assert files == {"runs", "page.html", "policy.npz", "policy.json", "episode.rrd"}
