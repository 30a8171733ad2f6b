"""FMU archives, unpacked into the cache: once for each content, and only what a run needs.

An archive may come from anywhere: all names are checked before anything is written, and no file
gets larger than the archive declares. What is unpacked is checked against the archive's checksums.
"""

import hashlib
import logging
import shutil
import stat
import zipfile
import zlib
from pathlib import Path, PurePosixPath
from typing import IO
from xml.parsers import expat

from cosim.base.storage import cache_dir, replacing

# Far above what FMUs hold, far below what fills a disk.
MAX_ENTRIES = 10_000
MAX_BYTES = 2**30  # packed, and all files together unpacked
MAX_DESCRIPTION_BYTES = 2**23  # parsed, it takes some thirty times as much
MAX_NAME_BYTES = 200  # of a file, and of each folder that it is in
MAX_RATIO = 200  # unpacked to packed; binaries are packed to a third, tables of zeros to 1/1000

_LOG = logging.getLogger(__name__)


def unpack(path: Path, needed: tuple[str, ...]) -> Path:
    """Folder that holds the needed files of an archive, whole.

    The folder is named by the archive's content. Files that are missing or damaged there are
    unpacked, each whole or not at all, also when two processes do so at once.

    Args:
        path: the archive.
        needed: names of files, which it must have, and of folders, with a slash at the end.

    Returns:
        The folder, absolute.

    Raises:
        zipfile.BadZipFile: the archive is damaged, lacks a file, passes a limit, or holds a name
            that leaves its folder or stands there twice; some damage makes zipfile raise others.
        OSError: the archive cannot be read, or the cache cannot be written.
    """
    with path.open("rb") as file:
        packed_bytes = path.stat().st_size
        if packed_bytes > MAX_BYTES:
            raise zipfile.BadZipFile(f"it is larger than {MAX_BYTES >> 20} MiB")
        digest = hashlib.file_digest(file, "sha256").hexdigest()[:16]
        with zipfile.ZipFile(file) as archive:
            _check(archive.infolist(), packed_bytes)
            for name in needed:
                if not name.endswith("/") and name not in map(_name, archive.infolist()):
                    raise zipfile.BadZipFile(f"it has no {name}")
            folder = (cache_dir("unpacked") / digest).absolute()
            for entry in archive.infolist():
                if _name(entry).startswith(needed):
                    _unpack_entry(archive, entry, folder / _name(entry))
    return folder


def _name(entry: zipfile.ZipInfo) -> str:
    """Name of an entry as the standards write it: without "./", and with "/" as separator."""
    name = entry.filename.replace("\\", "/")
    while name.startswith("./"):
        name = name[2:]
    return name


def require_plain(description: Path, most_bytes: int = MAX_DESCRIPTION_BYTES) -> None:
    """Refuse a description that could be far more than it looks, before it is parsed.

    Raises:
        ValueError: it is very large, or has a document type: there entities and other files come
            from, and no FMU or system needs one.
        xml.parsers.expat.ExpatError: it is no XML.
    """
    if description.stat().st_size > most_bytes:
        raise ValueError(f"{description.name} is larger than {most_bytes >> 20} MiB")

    def refuse(*_: object) -> None:
        raise ValueError(f"{description.name} has a document type; export it without")

    parser = expat.ParserCreate()
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(description.read_bytes(), True)


def _check(entries: list[zipfile.ZipInfo], packed_bytes: int) -> None:
    """Refuse an archive by what it declares."""
    if len(entries) > MAX_ENTRIES:
        raise zipfile.BadZipFile(f"it holds more than {MAX_ENTRIES} files")
    unpacked_bytes = sum(entry.file_size for entry in entries)
    if unpacked_bytes > MAX_BYTES:
        raise zipfile.BadZipFile(
            f"it unpacks to {unpacked_bytes >> 20} MiB, more than {MAX_BYTES >> 20} MiB"
        )
    if unpacked_bytes > MAX_RATIO * packed_bytes:
        raise zipfile.BadZipFile(f"it unpacks to more than {MAX_RATIO} times its size")
    files = {PurePosixPath(_name(e)) for e in entries if not _name(e).endswith("/")}
    names = set()
    for entry in entries:
        name, shown = PurePosixPath(_name(entry)), repr(entry.orig_filename[:80])
        # zipfile cuts names at a zero byte; a colon stands behind the letter of a drive.
        changed = entry.filename != entry.orig_filename
        if changed or name.is_absolute() or ":" in entry.filename or ".." in name.parts:
            raise zipfile.BadZipFile(f"its entry {shown} leaves the archive's folder")
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise zipfile.BadZipFile(f"its entry {shown} is a symbolic link")
        if any(len(part.encode(errors="replace")) > MAX_NAME_BYTES for part in name.parts):
            raise zipfile.BadZipFile(f"its entry {shown} has too long a name")
        if name in names or files.intersection(name.parents):
            raise zipfile.BadZipFile(f"its entry {shown} stands where another one does")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise zipfile.BadZipFile(f"its entry {shown} is not packed by the method 'deflate'")
        names.add(name)


def _unpack_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> None:
    """Write one entry, unless it is there already."""
    if _name(entry).endswith("/"):
        target.mkdir(parents=True, exist_ok=True)
        return
    if _is_whole(target, entry):
        return
    if target.exists():
        _LOG.warning("%s is damaged; it is unpacked again", target)
    if target.is_dir():
        shutil.rmtree(target)
    with archive.open(entry) as packed, replacing(target) as temporary:
        temporary.write_bytes(_read_whole(packed, entry.file_size))


def _read_whole(packed: IO[bytes], size: int) -> bytes:
    """Content of an entry, which must have the declared size."""
    content = packed.read(size + 1)
    if len(content) != size:
        raise zipfile.BadZipFile("a file in it has another size than declared")
    return content


def _is_whole(target: Path, entry: zipfile.ZipInfo) -> bool:
    """Return whether a file has the size and the checksum of its entry."""
    try:
        same_size = target.stat().st_size == entry.file_size
        return same_size and zlib.crc32(target.read_bytes()) == entry.CRC
    except OSError:
        return False
