"""Packing an FMU from its sources: what is refused; test_examples.py runs docs/own.md with it."""

import pytest


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (None, "not an unpacked FMI 3.0 FMU with sources"),
        ("<a/>", "buildDescription.xml: Unsupported"),
        ("no XML", "buildDescription.xml: Start tag expected"),
    ],
)
def test_other_folders_are_refused(build, message, tmp_path, command):
    (tmp_path / "mine" / "sources").mkdir(parents=True)
    (tmp_path / "mine" / "modelDescription.xml").touch()
    if build is not None:
        (tmp_path / "mine" / "sources" / "buildDescription.xml").write_text(build)
    done = command("fmu", "--sources", tmp_path / "mine", "--out", tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert message in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    done = command("fmu", "motor", "--sources", tmp_path / "mine", "--out", tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "leave other options out" in done.stderr
    done = command("fmu", "--sources", tmp_path / "nowhere", "--out", tmp_path)
    assert "nowhere is not an unpacked FMI 3.0 FMU with sources" in done.stderr


@pytest.mark.long
def test_errors_of_the_compiler_are_shown(tmp_path, command):
    from zipfile import ZipFile

    assert command("fmu", "motor", "--out", tmp_path).returncode == 0
    ZipFile(tmp_path / "VibrationMotor.fmu").extractall(tmp_path / "mine")
    (tmp_path / "mine" / "sources" / "motor.h").write_text("int x = ;\n")
    done = command("fmu", "--sources", tmp_path / "mine", "--out", tmp_path)
    assert done.returncode == 2
    assert "the C compiler failed" in done.stderr and "motor.h:1" in done.stderr
    assert not (tmp_path / "mine.fmu").exists()
