"""FMUs as exporters write them: what changes no result is accepted with a warning, else by name."""

import zipfile

import pytest

from cosim.fmi.fmu import Fmu, FmuError
from cosim.system.graph import Component
from cosim.system.system import System
from tests.cosim.system.test_refusals import changed

END = "</fmiModelDescription>"


@pytest.mark.parametrize(
    ("fmi", "replaced", "words"),
    [
        (3, ('causality="parameter" variability="fixed" start="1"',
             'causality="parameter" variability="fixed"'), "has no start value"),
        (2, ('causality="parameter" variability="fixed"',
             'causality="parameter" variability="constant" initial="exact"'), "is not allowed"),
        (2, ("<CoSimulation ", '<CoSimulation stepSize="0.1" '), "stepSize"),
        (3, ('name="v"', 'name="v" unit="1"'), 'The unit "1" of variable "v"'),
        (3, ('name="v"', 'name="v" unit="rpm" displayUnit="rps"'), 'The unit "rpm" of variable'),
        (2, (END, f'<VendorAnnotations><Tool name="x"/></VendorAnnotations>{END}'),
         "VendorAnnotations"),
    ],
)  # fmt: skip
def test_what_changes_no_result_is_a_warning(small, tmp_path, caplog, fmi, replaced, words):
    odd = changed(small("oscillator", fmi), tmp_path, *replaced)
    with System([Component("a", small("oscillator", fmi))], step_s=0.1) as system:
        expected = system.run(0.5).signals["a.x"]
    assert not caplog.messages
    with System([Component("a", odd)], step_s=0.1) as system:
        assert (system.run(0.5).signals["a.x"] == expected).all()
    (message,) = caplog.messages
    assert f"FMU {odd.name} of component a violates the standard: " in message
    assert words in message


def test_what_may_change_a_result_takes_an_option(small, tmp_path):
    odd = changed(small("oscillator", 2), tmp_path, 'name="v"', 'name="v" descriptio="m"')
    words = (
        r"component a: FMU .*\.fmu violates the standard \(.*'descriptio'.*accept it with --lenient"
    )
    with pytest.raises(FmuError, match=words):
        System([Component("a", odd)])
    System([Component("a", Fmu(odd, lenient=True))]).close()


def test_names_in_archives_may_begin_with_a_dot_or_have_backslashes(small, tmp_path):
    for separator, begin in (("/", "./"), ("\\", "")):
        path = tmp_path / f"{len(begin)}.fmu"
        with zipfile.ZipFile(small("ball").path) as source, zipfile.ZipFile(path, "w") as target:
            for name in source.namelist():
                target.writestr(begin + name.replace("/", separator), source.read(name))
        with System([Component("a", path)], step_s=0.1) as system:
            system.run(0.2)


def test_descriptions_have_a_size_that_can_be_raised(small, tmp_path):
    large = changed(small("ball"), tmp_path, END, f"<!--{1000 * '-x'}-->" * 5000 + END)
    with zipfile.ZipFile(large) as archive:
        content = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(large, "w", zipfile.ZIP_STORED) as archive:
        for name, each in content.items():
            archive.writestr(name, each)
    with pytest.raises(FmuError, match=r"modelDescription.xml is larger than 8 MiB"):
        Fmu(large)
    assert Fmu(large, most_bytes=2**24).variables
