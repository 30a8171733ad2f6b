"""The archives of the pair, and masters not written here that run them with the bits of ours."""

import json
import zipfile
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from fmpy.ssp.ssd import read_ssd, read_ssv

from benchmarks.masters import ssp as masters
from fmus.ssp.archive import VALUES, build_ssp
from fmus.ssp.system import PAIR, robots_with_motors
from fmus.variables import load_table
from tests.references.own import drive

STEP_S, DURATION_S = 1e-4, 0.05
NAMES = [
    "fmpy", "ecospy", "libcosimpy", "ecospy, FMI 3",
    "container by fmpy, FMI 2", "container by toolbox, FMI 2",
    "container by fmpy, FMI 3", "container by toolbox, FMI 3",
    "sequential container by toolbox, FMI 3",
]  # fmt: skip
SLOWEST = {"fmpy", "ecospy"}


class Archives(NamedTuple):
    first: Path
    second: Path


@pytest.fixture(scope="module")
def archives(tmp_path_factory) -> Archives:
    return Archives(*build_ssp(tmp_path_factory.mktemp("ssp")))


@pytest.fixture(scope="module")
def cases(tmp_path_factory) -> dict[str, masters.Case]:
    found = masters.cases(tmp_path_factory.mktemp("cases"), STEP_S, DURATION_S)
    return {case[0]: case for case in found}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.long if n in SLOWEST else ()) for n in NAMES]
)
def test_masters_have_the_bits_of_ours(cases, name):
    assert list(cases) == NAMES
    _, order, exchange_first, poses = cases[name]
    own = drive(DURATION_S, order, STEP_S, exchange_first=exchange_first)
    theirs = poses()
    assert theirs.shape == own.shape == (round(DURATION_S / 1e-3), len(PAIR), 7)
    assert theirs.tobytes() == own.tobytes()
    assert (abs(own[-1] - own[0])[:, :2] > 1e-9).any()  # they do move


def test_the_order_matters_and_so_does_the_first_exchange():
    usual = drive(DURATION_S, "gauss-seidel", STEP_S)
    for other in (drive(DURATION_S, "jacobi", STEP_S), drive(DURATION_S, exchange_first=True)):
        assert 0.0 < abs(other - usual)[..., :3].max() < 1e-5


@pytest.mark.long
def test_the_description_is_valid_and_says_what_is_set(archives):
    described: Any = read_ssd(str(archives.first)).system  # validated by fmpy
    system = robots_with_motors()
    values = {p.name: float(p.value) for p in read_ssv(str(archives.first), VALUES).parameters}
    for component, element in zip(system.components, described.elements, strict=True):
        ((held,),) = (binding.parameterValues for binding in element.parameterBindings)
        own = {p.name: float(p.value) for p in held.parameters}
        assert held.name == "initialValues"
        assert own == component.values
        assert own == {n: values[f"{component.name}.{n}"] for n in own}
    assert len(described.connections) == 3 * 2 * len(PAIR)
    assert not described.connectors


def test_connected_variables_fit():
    system = robots_with_motors()
    tables = {c.name: load_table(c.model) for c in system.components}
    for start, output, end, entry in system.connections:
        assert tables[start][output].causality == "output"
        assert tables[end][entry].causality == "input"
        assert tables[start][output].unit == tables[end][entry].unit


def test_the_second_archive_has_the_types_of_fmi_3(archives):
    with zipfile.ZipFile(archives.second) as archive:
        text = archive.read("SystemStructure.ssd").decode()
        assert "ssc:Float64" in text and "Real" not in text
        for name in ("VibrationMotor", "MiniRobot"):
            with archive.open(f"resources/{name}.fmu") as file, zipfile.ZipFile(file) as fmu:
                assert b'fmiVersion="3.0"' in fmu.read("modelDescription.xml")


@pytest.mark.long
def test_command_writes_both_archives_the_same_bytes_again(command, archives, tmp_path):
    done = command("fmu", "ssp", "--out", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    files = [Path(name) for name in json.loads(done.stdout.splitlines()[-1])["files"]]
    assert [path.name for path in files] == ["robots_ssp1.ssp", "robots_ssp2.ssp"]
    assert [path.read_bytes() for path in files] == [path.read_bytes() for path in archives]
