"""Inputs over time, from arrays, functions and files, and what is recorded as files."""

import json
import math
import sys

import numpy as np
import pytest
from pyarrow import csv, parquet

from cosim.recording.rrd import read_rrd
from cosim.system.graph import Component, GraphError, load_fmus
from cosim.system.inputs import read_inputs
from cosim.system.ssp.reader import read_system
from cosim.system.system import System
from minirobots.runner import run_named
from tests.cosim.system.test_refusals import changed

SSD = """<?xml version="1.0"?>
<SystemStructureDescription version="1.0" name="one"><System name="one">
  <Connectors><Connector name="place" kind="input"/></Connectors>
  <Elements><Component name="a" type="application/x-fmu-sharedlibrary" source="a.fmu"/></Elements>
  <Connections><Connection startConnector="place" endElement="a" endConnector="x_in">
    <LinearTransformation factor="2" offset="1"/></Connection></Connections>
</System></SystemStructureDescription>
"""


def test_arrays_and_functions_are_interpolated_and_held(small):
    inputs = {
        "a.Float64_input": ([0.0, 0.5, 0.5, 1.0], [0.0, 1.0, 5.0, 6.0]),  # with a jump at 0.5 s
        "a.Int32_input": ([0.0, 0.25, 0.75], [1, 2, 3]),
        "a.Boolean_input": ([0.1], [True]),
        "a.Float32_input": lambda time_s: 10.0 * time_s,
    }
    through = small("feedthrough")
    with System([Component("a", through)], step_s=0.125, inputs=inputs) as system:
        run = system.run(1.25)
    at_s = run.time_s[1:] - 0.125  # inputs hold over a step, from its beginning
    expected = np.where(at_s < 0.5, 2.0 * at_s, np.minimum(6.0, 4.0 + 2.0 * at_s))
    assert (run.signals["a.Float64_output"][1:] == expected).all()
    assert (run.signals["a.Int32_output"][1:] == 1 + (at_s >= 0.25) + (at_s >= 0.75)).all()
    assert run.signals["a.Boolean_output"].all()
    assert run.signals["a.Float32_output"][1:] == pytest.approx(10.0 * at_s)


@pytest.mark.parametrize("algorithm", ["extrapolated", "implicit"])
def test_inputs_over_time_keep_the_second_order(small, algorithm):
    decay = Component("a", small("dahlquist", 2), {"x": 0.0})
    errors = []
    for step_s in (0.02, 0.01):
        options = {"step_s": step_s, "algorithm": algorithm, "inputs": {"a.u": np.sin}}
        with System([decay], **options) as system:
            run = system.run(2.0)
        t = run.time_s
        exact = 0.5 * (np.sin(t) - np.cos(t) + np.exp(-t))  # x' = -x + sin t
        errors.append(np.abs(run.signals["a.x"] - exact).max())
    assert math.log2(errors[0] / errors[1]) > 1.95


@pytest.mark.parametrize(
    ("inputs", "words"),
    [
        ({"a.Float64_output": ([0], [1])}, "is of causality output"),
        ({"a.Int8_input": ([0], [300])}, "takes whole numbers from -128 to 127"),
        ({"a.UInt8_input": ([0], [-1])}, "takes whole numbers from 0 to 255"),
        ({"a.Int32_input": ([0], [0.5])}, "takes whole numbers"),
        ({"a.Float64_input": ([0, 1], [1])}, "give as many values as times"),
        ({"a.Float64_input": ([1, 0], [1, 1])}, "times that do not decrease"),
        ({"a.Float64_input": ([0], [math.nan])}, "needs finite values"),
        ({"a.Float64_input": ([0], ["x"])}, "values that are not numbers"),
        ({"b.u": ([0], [1])}, "is not a variable of a component"),
    ],
)
def test_inputs_that_do_not_fit_are_refused(small, inputs, words):
    with pytest.raises(GraphError) as caught:
        System([Component("a", small("feedthrough"))], inputs=inputs)
    assert words in str(caught.value)


def test_tables_have_units_and_connectors_of_the_system(small, tmp_path):
    (tmp_path / "a.fmu").write_bytes(small("oscillator").path.read_bytes())
    (tmp_path / "one.ssd").write_text(SSD)
    found = read_system(tmp_path / "one.ssd")
    fmus = load_fmus(found.components)
    table = tmp_path / "table.csv"
    table.write_text("time,place,a.F_in\n0,1,2\n1,3,4\n")
    read = read_inputs(table, fmus, found.entries)
    assert {name: list(values) for name, (_, values) in read.items()} == {
        "a.x_in": [3.0, 7.0], "a.F_in": [2.0, 4.0],
    }  # fmt: skip
    table.write_text("time,a.x_in [mm]\n0,1\n1,3\n")
    assert read_inputs(table, fmus, [])["a.x_in"][1] == pytest.approx([1e-3, 3e-3])
    for text, words in (
        ("t,a.x_in\n0,1\n", "it has no column time"),
        ("time,a.x_in\n0,fast\n", "column a.x_in has values that are not numbers"),
        ("time,a.x_in [N]\n0,1\n", "units N and m do not match"),
        ("time,a.y\n0,1\n", "component a has no variable 'y'"),
        ("time,place,a.x_in\n0,1,1\n", "two columns give a.x_in"),
    ):
        table.write_text(text)
        with pytest.raises(GraphError) as caught:
            read_inputs(table, fmus, found.entries)
        assert words in str(caught.value)


def test_units_of_columns_are_converted_to_those_of_connectors_or_refused(small, tmp_path):
    (tmp_path / "a.fmu").write_bytes(small("oscillator").path.read_bytes())
    said = SSD.replace('name="one"><S', 'name="one" xmlns:c="SystemStructureCommon"><S')
    said = said.replace('kind="input"/>', 'kind="input"><c:Real unit="mm"/></Connector>')
    mm = '<Units><c:Unit name="mm"><c:BaseUnit m="1" factor="0.001"/></c:Unit></Units>'
    said = said.replace("</System>", f"</System>{mm}")
    (tmp_path / "one.ssd").write_text(SSD)
    (tmp_path / "in_mm.ssd").write_text(said)
    table = tmp_path / "table.csv"
    table.write_text("time,place [m]\n0,0.5\n")
    plain, in_mm = (read_system(tmp_path / f"{name}.ssd") for name in ("one", "in_mm"))
    fmus = load_fmus(in_mm.components)
    read = read_inputs(table, fmus, in_mm.entries, in_mm.units)["a.x_in"][1]
    table.write_text("time,place\n0,500\n")
    assert read == pytest.approx(read_inputs(table, fmus, in_mm.entries, in_mm.units)["a.x_in"][1])
    table.write_text("time,place [m]\n0,0.5\n")
    with pytest.raises(GraphError, match=r"column place \[m\]: place has no unit; leave it out"):
        read_inputs(table, fmus, plain.entries, plain.units)


def test_a_name_may_end_in_brackets(small, tmp_path):
    path = changed(small("oscillator"), tmp_path, 'name="x_in"', 'name="x_in[1]"')
    fmus = load_fmus([Component("a", path)])
    for header, value in (("a.x_in[1]", 5.0), ("a.x_in[1] [mm]", 5e-3)):
        (tmp_path / "table.csv").write_text(f"time,{header}\n0,5\n")
        assert read_inputs(tmp_path / "table.csv", fmus, [])["a.x_in[1]"][1] == [value]


def test_command_reads_a_table_and_writes_a_recording(small, tmp_path, monkeypatch, capsys):
    (tmp_path / "a.fmu").write_bytes(small("oscillator").path.read_bytes())
    (tmp_path / "one.ssd").write_text(SSD)
    (tmp_path / "table.csv").write_text("time,place\n0,0\n1,1\n")
    monkeypatch.chdir(tmp_path)
    runs = {}
    for suffix in ("csv", "parquet", "rrd"):
        words = ["one.ssd", "--until", "1", "--step", "0.1", "--input", "table.csv", "--json"]
        words += ["--no-isolate", "--out", f"run.{suffix}"]
        monkeypatch.setattr(sys, "argv", ["system", *words])
        run_named("system")
        runs[suffix] = json.loads(capsys.readouterr().out.splitlines()[-1])["last"]
    assert runs["csv"] == runs["parquet"] == runs["rrd"]
    table, written = parquet.read_table("run.parquet"), csv.read_csv("run.csv")
    assert table["a.x"].equals(written["a.x"])
    signal = read_rrd(tmp_path / "run.rrd").signals["/a/x"]
    assert signal.values.tolist() == table["a.x"].to_pylist()
    assert signal.time_s == pytest.approx(table["time"].to_numpy())
