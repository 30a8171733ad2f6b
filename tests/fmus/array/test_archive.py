"""The archive of VibrationMotors, and fmpy as its importer."""

import zipfile
from typing import Any

import fmpy
import pytest
from fmpy.fmi3 import FMU3Slave
from fmpy.validation import validate_fmu

from cosim.model.params import FIG_7, TABLE_II, describe


def test_validator_has_no_complaint(array_fmu):
    assert validate_fmu(str(array_fmu)) == []


def test_variables_are_those_of_one_motor_but_for_their_dimension(array_fmu, fmu):
    arrays, single = (fmpy.read_model_description(str(path)) for path in (array_fmu, fmu))
    # fmusim 0.0.39 crashes on a dimension that stands behind the array.
    assert [v.name for v in arrays.modelVariables][:2] == ["n", "samples"]
    alone: dict[str, Any] = {v.name: v for v in single.modelVariables}
    for v in arrays.modelVariables:
        if v.name.endswith("_samples"):
            assert v.shape == (1, 4)
        if v.name in {"n", "restart", "samples"} or v.name.endswith("_samples"):
            assert v.description
            continue
        assert (v.description, v.unit, v.nominal) == tuple(
            getattr(alone[v.name], key) for key in ("description", "unit", "nominal")
        )
        tunable = v.name in {*TABLE_II._fields, "theta_start"}
        assert v.variability == ("tunable" if tunable else alone[v.name].variability)
        scalar = v.name in {"time", "step_size", "closed_loop"}
        assert v.shape == (() if scalar else (4,)) or (scalar and not v.dimensions)
        if v.start is not None and not scalar:
            assert str(v.start).split() == [alone[v.name].start] * 4
    assert set(describe(TABLE_II)) <= {v.name for v in arrays.modelVariables}
    assert arrays.modelExchange is None
    with zipfile.ZipFile(array_fmu) as archive:
        page = archive.read("documentation/index.html").decode()
    assert "<td>restart</td>" in page and "$" not in page


def test_fmpy_drives_three_motors(array_fmu, tmp_path):
    description: Any = fmpy.read_model_description(str(array_fmu))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    fmpy.extract(str(array_fmu), str(tmp_path))
    slave = FMU3Slave(guid=description.guid, unzipDirectory=str(tmp_path), instanceName="three",
                      modelIdentifier=description.coSimulation.modelIdentifier)  # fmt: skip
    slave.instantiate()
    slave.enterConfigurationMode()
    slave.setUInt64([reference["n"]], [3])
    slave.exitConfigurationMode()
    slave.setFloat64([reference["omega_des"]], [FIG_7.omega_des, 300.0, -FIG_7.omega_des])
    slave.enterInitializationMode()
    slave.exitInitializationMode()
    for k in range(2000):
        slave.doStep(k * 1e-3, 1e-3)
    slave.setInt64([reference["restart"]], [0, 1, 0])
    slave.doStep(2.0, 1e-3)
    first, second, third = slave.getFloat64([reference["omega"]], 3)
    assert first == pytest.approx(FIG_7.omega_des, rel=0.02)
    assert 0.0 < second < 100.0
    assert third == pytest.approx(-FIG_7.omega_des, rel=0.02)
    slave.terminate()
    slave.freeInstance()


def test_fmpy_simulates_the_motors_of_the_start(array_fmu):
    result = fmpy.simulate_fmu(
        str(array_fmu), stop_time=0.2, start_values={"omega_des": [0.0, 300.0, 500.0, 700.0]}
    )
    assert result["omega"].shape[1:] == (4,)
    assert result["omega"][-1] == pytest.approx([0.0, 300.0, 500.0, 700.0], rel=0.1)
