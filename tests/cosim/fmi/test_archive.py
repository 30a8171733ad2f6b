"""Archives of FMUs: what is unpacked, where, how often, and what is refused."""

import struct
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import fmpy
import pytest

from cosim.fmi.fmu import FmuError
from cosim.fmi.motor import Motor, MotorFmu

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

    def make(*entries: tuple[str | zipfile.ZipInfo, bytes]) -> Path:
        path = tmp_path / "foreign.fmu"
        path.write_bytes(motor_fmu.read_bytes())
        with zipfile.ZipFile(path, "a") as file:
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
    """Files that are unpacked in the cache, by their names in the archive."""
    files = (cache / "unpacked").glob("*/**/*")
    return {"/".join(p.relative_to(cache).parts[2:]): p for p in files if p.is_file()}


def test_only_what_a_run_needs_is_unpacked(archive, cache):
    path = archive(
        ("resources/table.csv", b"1"), ("documentation/a.html", b""), ("binaries/other/b.so", b"")
    )
    Motor(MotorFmu(path), "m").close()
    assert unpacked(cache).keys() == {"modelDescription.xml", LIBRARY, "resources/table.csv"}


def test_nothing_is_unpacked_twice(motor_fmu, cache):
    MotorFmu(motor_fmu)
    stamps = {path: path.stat().st_mtime_ns for path in unpacked(cache).values()}
    MotorFmu(motor_fmu)
    assert {path: path.stat().st_mtime_ns for path in unpacked(cache).values()} == stamps


DAMAGES = {
    "cut": lambda library: library.write_bytes(library.read_bytes()[: library.stat().st_size // 2]),
    "emptied": lambda library: library.write_bytes(b""),
    "removed": Path.unlink,
    "exchanged": lambda library: library.write_bytes(library.read_bytes()[::-1]),
    "a folder in its place": lambda library: (library.unlink(), library.mkdir()),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
@pytest.mark.parametrize("name", [LIBRARY, "modelDescription.xml"])
def test_a_damaged_folder_is_unpacked_again(motor_fmu, cache, caplog, name, damage):
    MotorFmu(motor_fmu)
    place = unpacked(cache)[name]
    content = place.read_bytes()
    damage(place)
    Motor(MotorFmu(motor_fmu), "m").close()
    assert place.read_bytes() == content
    assert "is damaged: unpacking it again" in caplog.text


def test_what_a_killed_process_left_is_replaced(motor_fmu, cache):
    MotorFmu(motor_fmu)
    (folder,) = (path for path in (cache / "unpacked").iterdir() if path.is_dir())
    folder.rename(folder.with_suffix(".part"))
    (folder.with_suffix(".part") / "modelDescription.xml").write_text("cut")
    Motor(MotorFmu(motor_fmu), "m").close()
    assert unpacked(cache).keys() == {"modelDescription.xml", LIBRARY}


def test_several_unpack_at_once(motor_fmu, cache):
    with ThreadPoolExecutor(8) as threads:
        fmus = list(threads.map(MotorFmu, [motor_fmu] * 16))
    assert len({fmu.folder for fmu in fmus}) == 1
    Motor(fmus[0], "m").close()
    assert unpacked(cache).keys() == {"modelDescription.xml", LIBRARY}


def test_cache_may_be_given_relative_to_the_working_directory(motor_fmu, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINIROBOTS_CACHE", "here")
    Motor(MotorFmu(motor_fmu), "m").close()


@pytest.mark.parametrize(("begin", "separator"), [("./", "/"), ("", "\\")])
def test_names_may_begin_with_a_dot_or_have_backslashes(motor_fmu, tmp_path, begin, separator):
    path = tmp_path / "other.fmu"
    with zipfile.ZipFile(motor_fmu) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            target.writestr(begin + name.replace("/", separator), source.read(name))
    Motor(MotorFmu(path), "m").close()


@pytest.mark.parametrize("name", ["resources/../../../evil", "/evil", "..\\evil"])
def test_nothing_is_written_outside_the_folder(archive, cache, name):
    MotorFmu(archive((name, b"content")))
    (folder,) = (path for path in (cache / "unpacked").iterdir() if path.is_dir())
    assert [p for p in cache.rglob("evil") if folder not in p.parents] == []


def test_archives_that_unpack_to_gigabytes_are_refused(archive, cache):
    path = declare_size(archive(("resources/a", b"content")), "resources/a", 3_000_000_000)
    with pytest.raises(FmuError, match="unpacks to 2861 MiB, more than 1024 MiB"):
        MotorFmu(path)
    assert unpacked(cache) == {}
