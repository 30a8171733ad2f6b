"""The FMUs before judges not written here, compared with the co-simulation's own steps."""

import json
import sys
from importlib.metadata import version

import numpy as np
import pytest

from tests.judge import __main__ as judge
from tests.judge.experiment import OUTPUTS, reference_rows

BITS, SAYS_NOTHING = "the same bits", "not at hand: name it with --"
# Stands in for fmusim: writes outputs in a wrong order.
FMUSIM = f"""#!{sys.executable}
import sys
rows = [["time", *{sorted(OUTPUTS)}], [0.0] * 6, *([0.0, *row] for row in ROWS)]
text = "".join(",".join(map(str, row)) + "\\n" for row in rows)
open(sys.argv[sys.argv.index("--output-file") + 1], "w").write(text)
"""


def test_everything_moves_in_the_experiment():
    assert reference_rows()[-1, 1] > 650.0
    assert (np.ptp(reference_rows(), axis=0) > 0.0).all()


@pytest.mark.long
def test_judges_agree_and_their_table_is_written(command, tmp_path):
    """But for a program that exchanges outputs."""
    page, program, out = tmp_path / "page.md", tmp_path / "fmusim-9.1", tmp_path / "out"
    page.write_text(f"before\n{judge.BEGIN}old\n{judge.END}after\n")
    program.write_text(FMUSIM.replace("ROWS", str(reference_rows().tolist())))
    program.chmod(0o755)
    run = command(judge, "--out", out, "--page", page, "--fmusim", program, "--json")
    assert run.returncode == 2
    assert "a judge does not agree" in run.stderr
    verdicts = json.loads((out / "verdicts.json").read_text())["verdicts"]
    assert verdicts == json.loads(run.stdout.splitlines()[-1])["verdicts"]
    motors, array = [f"VibrationMotor, FMI {fmi}" for fmi in "23"], "VibrationMotors, FMI 3"
    assert {(v["tool"], v["artefact"]): v["says"] for v in verdicts} == {
        **{("fmpy, validator", of): "valid" for of in (*motors, array)},
        **{(tool, of): BITS for tool in ("fmpy", "ecospy") for of in motors},
        ("libcosimpy", motors[0]): BITS,
        **{("fmusim", of): "simulated" for of in motors},
        ("FMU Compliance Checker", motors[0]): f"{SAYS_NOTHING}fmucheck",
        **{("VDMCheck", of): f"{SAYS_NOTHING}vdmcheck" for of in (motors[1], array)},
    }
    wrong = [v for v in verdicts if v["agrees"] is False]
    assert {(v["tool"], v["version"]) for v in wrong} == {("fmusim", "9.1")}
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text
    assert f"| ecospy | {version('ecospy')} | VibrationMotor, FMI 3 | the same bits | 0 |" in text
    page.write_text("no place")
    refused = command(judge, "--out", out, "--page", page)
    assert (refused.returncode, len(refused.stderr.splitlines())) == (2, 1)
