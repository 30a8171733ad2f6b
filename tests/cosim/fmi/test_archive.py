"""Archives of FMUs: what is unpacked, where, how often, and what is refused."""

import os
import signal
import stat
import struct
import subprocess
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import fmpy
import pytest

from cosim.coupling.fmu import FmuError, MotorFmu

LIBRARY = f"binaries/{fmpy.platform_tuple}/VibrationMotor{fmpy.sharedLibraryExtension}"


@pytest.fixture(autouse=True)
def cache(motor_fmu, tmp_path, monkeypatch) -> Path:
    """An empty cache; the FMU comes from the session's."""
    folder = tmp_path / "place" / "cache"
    monkeypatch.setenv("MINIROBOTS_CACHE", str(folder))
    return folder


@pytest.fixture
def archive(motor_fmu, tmp_path):
    """A copy of the motor FMU with further entries."""

    def make(*entries: tuple[str | zipfile.ZipInfo, bytes], packed=zipfile.ZIP_DEFLATED) -> Path:
        path = tmp_path / "foreign.fmu"
        path.write_bytes(motor_fmu.read_bytes())
        with zipfile.ZipFile(path, "a", packed) as file:
            for name, content in entries:
                file.writestr(name, content)
        return path

    return make


def declare_size(path: Path, name: str, size: int) -> Path:
    """Make an archive declare another size of its entry, in both places where sizes stand."""
    with zipfile.ZipFile(path) as file:
        local = file.getinfo(name).header_offset
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, local + 22, size)
    directory = data.rindex(name.encode()) - 46
    assert data[directory : directory + 4] == b"PK\1\2"
    struct.pack_into("<I", data, directory + 24, size)
    path.write_bytes(data)
    return path


def unpacked(cache: Path) -> dict[str, Path]:
    """Files in the only folder of the cache by their names in the archive."""
    (folder,) = (cache / "unpacked").iterdir()
    return {p.relative_to(folder).as_posix(): p for p in folder.rglob("*") if p.is_file()}


def test_only_what_a_run_needs_is_unpacked(archive, cache):
    path = archive(
        ("resources/table.csv", b"1"), ("documentation/a.html", b""), ("binaries/other/b.so", b"")
    )
    MotorFmu(path).instantiate("m").close()
    assert unpacked(cache).keys() == {"modelDescription.xml", LIBRARY, "resources/table.csv"}


def test_nothing_is_unpacked_twice(motor_fmu, cache):
    MotorFmu(motor_fmu)
    stamps = {path: path.stat().st_mtime_ns for path in unpacked(cache).values()}
    MotorFmu(motor_fmu)
    assert {path: path.stat().st_mtime_ns for path in unpacked(cache).values()} == stamps


def test_nothing_is_left_by_a_run_that_is_killed(motor_fmu, cache, tmp_path):
    MotorFmu(motor_fmu)
    (tmp_path / "temporary").mkdir()
    code = (
        "import os, sys; from pathlib import Path; from cosim.coupling.fmu import MotorFmu; "
        "fmu = MotorFmu(Path(sys.argv[1])); os.kill(os.getpid(), int(sys.argv[2]))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code, str(motor_fmu), str(int(signal.SIGKILL))],
        env=os.environ | {"TMPDIR": str(tmp_path / "temporary")},
        check=False,
    )
    assert run.returncode == -signal.SIGKILL
    assert list((tmp_path / "temporary").iterdir()) == []
    assert unpacked(cache).keys() == {"modelDescription.xml", LIBRARY}


def test_several_unpack_at_once(motor_fmu, cache):
    with ThreadPoolExecutor(8) as threads:
        fmus = list(threads.map(MotorFmu, [motor_fmu] * 16))
    assert len({fmu.folder for fmu in fmus}) == 1
    fmus[0].instantiate("m").close()
    assert unpacked(cache).keys() == {"modelDescription.xml", LIBRARY}


@pytest.mark.parametrize("name", ["modelDescription.xml", LIBRARY])
@pytest.mark.parametrize("damage", ["missing", "empty", "cut", "changed", "folder"])
def test_damaged_files_are_unpacked_again(motor_fmu, cache, caplog, name, damage):
    MotorFmu(motor_fmu)
    path = unpacked(cache)[name]
    content = path.read_bytes()
    path.unlink()
    if damage == "folder":
        path.mkdir()
        (path / "file").touch()
    elif damage != "missing":
        middle = len(content) // 2
        flipped = bytes([content[middle] ^ 1])
        changes = {"empty": b"", "cut": content[:-1],
                   "changed": content[:middle] + flipped + content[middle + 1 :]}  # fmt: skip
        path.write_bytes(changes[damage])
    MotorFmu(motor_fmu).instantiate("m").close()
    assert path.read_bytes() == content
    assert [f"{path} is damaged" in message for message in caplog.messages] == (
        [] if damage == "missing" else [True]
    )


def test_cache_may_be_given_relative_to_the_working_directory(motor_fmu, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINIROBOTS_CACHE", "here")
    MotorFmu(motor_fmu).instantiate("m").close()


@pytest.mark.parametrize(
    "name",
    ["../../evil", "resources/../../../evil", "/evil", "//host/evil", "C:evil", "C:/evil",
     "resources\\..\\..\\evil", "documentation/../../evil", "resources/file\0.txt"],
)  # fmt: skip
def test_names_that_leave_the_folder_are_refused(archive, cache, tmp_path, name):
    entry = zipfile.ZipInfo("entry")
    entry.filename = name  # as no tool would write it
    path = archive((entry, b"content"))
    with pytest.raises(FmuError, match=r"foreign\.fmu is broken .*leaves the archive's folder"):
        MotorFmu(path)
    assert not cache.exists()
    assert list(tmp_path.rglob("evil*")) == []


def test_symbolic_links_are_refused(archive):
    link = zipfile.ZipInfo("resources/link")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with pytest.raises(FmuError, match="'resources/link' is a symbolic link"):
        MotorFmu(archive((link, b"/etc")))


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("names", [["resources/a"] * 2, ["resources/a", "resources/a/b"]])
def test_entries_in_each_other_s_place_are_refused(archive, names):
    with pytest.raises(FmuError, match=rf"'{names[1]}' .*another"):
        MotorFmu(archive(*((name, b"content") for name in names)))


def test_other_methods_of_packing_are_refused(archive):
    path = archive(("resources/a", b"content"), packed=zipfile.ZIP_BZIP2)
    with pytest.raises(FmuError, match=r"'resources/a' .*'deflate'"):
        MotorFmu(path)


def test_too_many_entries_are_refused(archive):
    path = archive(*((f"documentation/{k}", b"") for k in range(10_000)))
    with pytest.raises(FmuError, match="holds more than 10000 files"):
        MotorFmu(path)


def test_archives_that_swell_are_refused(archive, cache):
    path = archive(("resources/zeros", bytes(20_000_000)))
    with pytest.raises(FmuError, match="unpacks to more than 200 times its size"):
        MotorFmu(path)
    assert not cache.exists()


def test_archives_that_unpack_to_gigabytes_are_refused(archive, cache):
    path = declare_size(archive(("resources/a", b"content")), "resources/a", 3_000_000_000)
    with pytest.raises(FmuError, match="unpacks to 2861 MiB, more than 1024 MiB"):
        MotorFmu(path)
    assert not cache.exists()


@pytest.mark.parametrize("declared", [10, 2_000_000])
def test_declared_sizes_that_lie_are_found_out(archive, cache, declared):
    content = os.urandom(1_000_000)
    path = declare_size(archive(("resources/a", content)), "resources/a", declared)
    with pytest.raises(FmuError, match=r"foreign\.fmu is broken"):
        MotorFmu(path)
    assert "resources/a" not in unpacked(cache)
    assert not any(name.startswith("resources/.") for name in unpacked(cache))
