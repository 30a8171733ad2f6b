"""Result files that `agent` and `cosim` write, each read in one place.

Their writers own their content; figures and tables take what they show from it.
"""

from pathlib import Path
from typing import Any

import msgspec

from analysis.reading.results import RESULTS
from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_json


class ResultError(UserError):
    """A result that is missing, damaged, or of another kind."""


class RunEpisode(msgspec.Struct, frozen=True):
    """An episode in the summary of a run; fields as in `agent.evaluation.rollout.EpisodeResult`."""

    outcome: str
    path_length_cm: float
    sim_time_s: float
    recording: str | None


class TransferRow(msgspec.Struct, frozen=True):
    """A row of the table of `cosim.transfer`; numbers that no episode has are None.

    Attributes:
        scenario: name.
        method: how the policy was trained.
        mu: friction coefficient.
        episodes: their number.
        success, collision, out_of_board, timeout: shares, with the ends of 95 % intervals.
        path_ratio_to_grid: mean path over that on the grid, with the ends of its interval.
        safety_margin_m: of the safety layer; 0 if it is off.
    """

    scenario: str
    method: str
    mu: float
    episodes: int
    success: float | None
    success_low: float | None
    success_high: float | None
    collision: float | None
    collision_low: float | None
    collision_high: float | None
    out_of_board: float | None
    out_of_board_low: float | None
    out_of_board_high: float | None
    timeout: float | None
    timeout_low: float | None
    timeout_high: float | None
    path_ratio_to_grid: float | None
    path_ratio_to_grid_low: float | None
    path_ratio_to_grid_high: float | None
    safety_margin_m: float = 0.0


class _TransferTable(msgspec.Struct, frozen=True):
    rows: list[TransferRow]


class _RunSummary(msgspec.Struct, frozen=True):
    episodes: list[RunEpisode]


def kind_of(name: str, results: Path) -> Kind:
    """How messages speak of a result."""
    result = RESULTS[name]
    return Kind(
        f"result of `python -m {result.module}`", f"run `{result.command(results)}`", ResultError
    )


def read_experiment(name: str, results: Path) -> dict[str, Any]:
    """What `agent.experiments` says of an experiment.

    Raises:
        ResultError: there is no such result, or it is of another experiment.
    """
    path, kind = RESULTS[name].proof_in(results), kind_of(name, results)
    content = read_json(path, kind, dict[str, Any])
    if content.get("experiment") != name:
        raise ResultError(f"{path}: not a result of {name}; {kind.mend}")
    return content


def read_transfer(results: Path) -> list[TransferRow]:
    """Rows of the table of `cosim.transfer`.

    Raises:
        ResultError: there is no such result, or it is damaged.
    """
    path = RESULTS["transfer"].proof_in(results)
    return read_json(path, kind_of("transfer", results), _TransferTable).rows


def read_run(scenario: str, results: Path) -> list[RunEpisode]:
    """Episodes of a run of `cosim.run`; none if it was not run.

    Raises:
        ResultError: its summary is damaged.
    """
    result = RESULTS[f"episodes_{scenario}"]
    if not result.exists(results):
        return []
    path = result.proof_in(results)
    return read_json(path, kind_of(result.name, results), _RunSummary).episodes
