"""Recordings of many episodes as a catalog of Rerun: a table of them, each to be opened from it.

Rerun's server reads what the table shows (properties of the recordings) and leaves the rest in the
files until an episode is opened. Every folder with recordings is a dataset.
"""

import contextlib
import json
import re
from collections import defaultdict
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import rerun.blueprint as rrb
from rerun.blueprint import table as rrt

from agent.training.runs import RECORDING_FILE
from cosim.base.errors import UserError, installing
from cosim.base.storage import temporary_folder
from cosim.coupling.rl_step import sampled_of
from cosim.recording.blueprint import episode_blueprint
from cosim.recording.file import APPLICATION

if TYPE_CHECKING:
    from rerun.catalog import DatasetEntry

# Columns of the table in their order: what they are called, and where the catalog has them.
COLUMNS = {
    "outcome": "property:result:outcome",
    "path_length_cm": "property:result:path_length_cm",
    "sim_time_s": "property:result:sim_time_s",
    "contact_time_s": "property:result:contact_time_s",
    "energy_j": "property:result:energy_j",
    "scenario": "property:episode:scenario",
    "method": "property:episode:method",
    "mu": "property:episode:friction",
    "seed": "property:episode:seed",
    "episode": "property:episode:episode",
    "starts": "property:episode:starts",
}
_PREVIEW = "recording link"  # the viewer's own column, which opens an episode
_SEGMENT, _FILES = "rerun_segment_id", "rerun_storage_urls"
_TARGETS, _BOARD = "property:episode:targets_m", "property:episode:board_m"


class CatalogError(UserError):
    """Error in serving recordings. The message names the place and how to fix it."""


class Dataset(msgspec.Struct, frozen=True):
    """The recordings of a folder.

    Attributes:
        name: of the folder, from the one that is browsed.
        address: for the viewer.
        episodes: by column of `COLUMNS`, None where a recording lacks it; also the
            `recording` and its `file`.
        left_out: files that the server did not take: damaged ones, and repeated recordings.
    """

    name: str
    address: str
    episodes: list[dict[str, Any]]
    left_out: list[str]


def find_recordings(folder: Path) -> dict[str, list[Path]]:
    """Recordings of episodes below a folder, by a name made of their own folder's.

    Raises:
        CatalogError: there are none.
    """
    found: dict[str, list[Path]] = defaultdict(list)
    for path in sorted(folder.rglob("*.rrd")):
        if path.name != RECORDING_FILE:
            name = path.parent.relative_to(folder).as_posix()
            name = folder.resolve().name if name == "." else name
            found[re.sub(r"[^\w.]+", "-", name)].append(path)  # catalogs have no slashes
    if not found:
        raise CatalogError(
            f"{folder}: no recordings of episodes below it; name the --out of a run that records"
        )
    return dict(found)


@contextlib.contextmanager
def serving(folder: Path, port: int = 0) -> Iterator[list[Dataset]]:
    """Serve all recordings below a folder to viewers of this machine.

    Args:
        folder: to search.
        port: to listen on, 0 for a free one.

    Yields:
        The datasets.

    Raises:
        CatalogError: there are no recordings, the port is taken, or the extra catalog is missing.
    """
    recordings = find_recordings(folder)
    if find_spec("datafusion") is None:
        raise CatalogError(f"a catalog needs the extra catalog: `{installing('catalog')}`")
    from rerun.server import Server

    with contextlib.ExitStack() as stack:
        layouts = Path(stack.enter_context(temporary_folder()))
        try:
            server = Server(host="127.0.0.1", port=port, datasets={**recordings})
        except (OSError, RuntimeError, ValueError) as error:
            raise CatalogError(
                f"{folder}: Rerun's server does not start ({error}); take another --port"
            ) from error
        stack.enter_context(server)
        client = server.client()
        yield [
            _dataset(client.get_dataset(name), paths, layouts, server.url())
            for name, paths in recordings.items()
        ]


def _dataset(entry: "DatasetEntry", paths: list[Path], layouts: Path, url: str) -> Dataset:
    """Read the table of a dataset, and set how viewers show it and its episodes."""
    table = entry.segment_table().to_arrow_table()
    rows = [
        {name: _value(row.get(source)) for name, source in COLUMNS.items()}
        | {"recording": row[_SEGMENT], "file": _value(row[_FILES])}
        for row in table.to_pylist()
    ]
    taken = {row["file"] for row in rows}
    left_out = [str(path) for path in paths if path.absolute().as_uri() not in taken]
    for row in table.to_pylist():
        targets, board = (json.loads(_value(row.get(key)) or "null") for key in (_TARGETS, _BOARD))
        if targets and board:  # the layout of one of its episodes is that of all
            path = layouts / f"{entry.id}.rbl"
            episode_blueprint(sampled_of(len(targets)), tuple(board)).save(APPLICATION, path)
            entry.register_blueprint(path.as_uri())
            break
    path = layouts / f"{entry.id}_table.rbl"
    _table_layout(table.schema.names).save(APPLICATION, path)
    entry.register_blueprint(path.as_uri(), segment_table=True)
    return Dataset(entry.name, f"{url}/dataset/{entry.id}", rows, left_out)


def _value(entry: Any) -> Any:
    """A property is a list of one; none if the recording has it not."""
    if isinstance(entry, list):
        return entry[0] if entry else None
    return entry


def _table_layout(present: list[str]) -> rrt.TableBlueprint:
    """The columns of the table that are there, after a preview; all others are hidden."""
    arena = rrb.Spatial3DView(origin="/world", name="arena")
    columns = [rrt.Column(_PREVIEW, name="recording", column_type=rrt.PreviewCell(arena))]
    shown = {source: name for name, source in COLUMNS.items() if source in present}
    columns += [rrt.Column(source, name=name) for source, name in shown.items()]
    hidden = (name for name in present if name not in shown)
    columns += [rrt.Column(name, visible=False) for name in hidden]
    return rrt.TableBlueprint(
        table_layout=rrt.TableLayout(columns=columns),
        previews_config=rrt.PreviewsConfig(timeline="sim_time"),
    )
