"""Results of a run of a system, and their files."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow
from pyarrow import csv, parquet

from cosim.base.storage import replacing


class Share(NamedTuple):
    """Share of a run's time that a component took.

    Attributes:
        steps: calls of its DoStep, those rolled back included.
        rollbacks: steps that were too inaccurate and rolled back.
        time_s: that its calls took; 0 if that was not measured.
        warnings: steps of this run that returned a warning.
    """

    steps: int
    rollbacks: int
    time_s: float
    warnings: int


class SystemRun(NamedTuple):
    """Results of a run.

    Attributes:
        time_s: (n,), of the rows.
        signals: (n, …) of every recorded variable by "component.variable": float64, float32,
            integers, or bool.
        ended: what ended the run before its time, such as "stair asked to end at 9 s"; else None.
        profile: by component.
    """

    time_s: np.ndarray
    signals: dict[str, np.ndarray]
    ended: str | None
    profile: dict[str, Share]


def write_run(path: Path, run: "SystemRun") -> None:
    """Write recorded rows as CSV or Parquet, by the suffix; arrays have a column per value."""
    columns: dict[str, Any] = {"time": run.time_s}
    for name, values in run.signals.items():
        if values.ndim == 1:
            columns[name] = values
        else:
            flat = values.reshape(len(values), -1)
            columns |= {f"{name}[{k}]": flat[:, k].copy() for k in range(flat.shape[1])}
    table = pyarrow.table(columns)
    with replacing(path) as temporary:
        (csv.write_csv if path.suffix == ".csv" else parquet.write_table)(table, temporary)
