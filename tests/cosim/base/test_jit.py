"""Compiled kernels in the cache: found again, and compiled again where they are damaged."""

import os
import subprocess
import sys

SCRIPT = """
from cosim.base.errors import run_command
from cosim.physics.forces import platform_force
force = platform_force
run_command(lambda: print(force(0.1, 0.2, 9.81, 0.3, 0.4), force.stats.cache_hits))
"""


def flip(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


def test_damaged_kernels_are_compiled_again(tmp_path):
    def run():
        return subprocess.run(
            [sys.executable, "-c", SCRIPT],
            env=os.environ | {"MINIROBOTS_CACHE": str(tmp_path)},
            capture_output=True,
            text=True,
            check=False,
        )

    first, found = run(), run()
    assert (first.stderr, found.stderr) == ("", "")
    force = first.stdout.removesuffix("Counter()\n")
    assert found.stdout.startswith(force)
    assert "Counter()" not in found.stdout
    for ending in ("nbi", "nbc"):
        (file,) = tmp_path.rglob(f"forces.platform_force*.{ending}")
        flip(file)
        again = run()
        assert {*again.stderr.splitlines()} == {
            f"{file} is not as it was kept: it is compiled again"
        }
        assert again.stdout == first.stdout
    file.unlink()
    file.mkdir()
    done = run()
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith(f"error: {file}: a folder is where")
