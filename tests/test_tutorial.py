"""The tutorial, run as it stands."""

import json
import re
import shlex
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "tutorial.md"
BLOCK = re.compile(r'^```(\w+)(?: title="([\w.]+)")?\n(.*?)^```$', re.M | re.S)


@pytest.mark.long
def test_tutorial_runs_as_written(tmp_path, monkeypatch, capsys, command):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    for language, file, content in BLOCK.findall(PAGE.read_text("utf-8")):
        if file:
            Path(file).write_text(content)
        elif language == "python":
            exec(compile(content, str(PAGE), "exec"), {})
            assert "success after" in capsys.readouterr().out
        else:
            for line in content.splitlines():
                program, name, *arguments = shlex.split(line)
                assert program == "minirobots"
                done = command(name, *arguments)
                assert done.returncode == 0, done.stderr
    runs = tmp_path / "runs"
    for name, expected in (("greedy", "collision"), ("learnt", "success")):
        (file,) = (runs / name).glob("*.jsonl")
        outcomes = [json.loads(line)["outcome"] for line in file.read_text().splitlines()[1:]]
        assert outcomes == [expected] * 10
    assert (
        json.loads((runs / "certified" / "certificate.json").read_text())["verdict"] == "certified"
    )
    rows = (runs / "friction" / "study.md").read_text().splitlines()[2:]
    assert [row.split(" | ")[0].strip("| ") for row in rows] == ["greedy"] * 2 + ["learnt"] * 2
