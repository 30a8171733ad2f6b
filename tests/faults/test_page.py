"""docs/reliability.md names tests that exist, and all of this folder."""

import re
from pathlib import Path

from tests.battery import ROOT, SECTIONS, checks_by_name, count


def functions_of(file: Path) -> set[str]:
    return set(re.findall(r"^def (test_\w+)", file.read_text(encoding="utf-8"), re.MULTILINE))


def test_every_named_test_exists():
    found = [test for some in checks_by_name().values() for test in some]
    assert len(found) > 40
    assert [(file, name) for file, name in found if name not in functions_of(ROOT / file)] == []
    assert {section for section, some in checks_by_name().items() if some} == set(SECTIONS)


def test_every_test_of_this_folder_is_named():
    found = {test for some in checks_by_name().values() for test in some}
    here = sorted(Path(__file__).parent.glob("test_*.py"))
    own = {
        (str(p.relative_to(ROOT)), t) for p in here if p != Path(__file__) for t in functions_of(p)
    }
    assert own - found == set()


def test_a_report_is_counted(tmp_path):
    cases = (
        ("test_disks", "test_a_full_disk[FMU]", ""),
        ("test_endurance", "test_an_hour[True]",
         '<properties><property name="hours" value="1.0"/></properties>'),
        ("test_kills", "test_killed_once[FMU-0]", '<failure message="no"/>'),
    )  # fmt: skip
    lines = "".join(
        f'<testcase classname="tests.faults.{file}" name="{name}">{inner}</testcase>'
        for file, name, inner in cases
    )
    report = tmp_path / "report.xml"
    report.write_text(f"<testsuites><testsuite>{lines}</testsuite></testsuites>")
    assert count(report) == {
        "faults_survived": 1, "files_refused": 0, "long_runs": 1, "hours_run": 1.0, "same_again": 0,
        "lost": ["tests/faults/test_kills.py::test_killed_once[FMU-0]"],
    }  # fmt: skip
