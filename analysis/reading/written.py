"""Result files that `agent` and `cosim` write, each read in one place.

Their writers own their content; figures and tables take what they show from it.
"""

from pathlib import Path

from agent.evaluation.series import RunSummary
from agent.experiments.results import ExperimentResult
from agent.study.transfer import TransferReport
from analysis.reading.results import RESULTS
from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_json
from cosim.simulation.result import EpisodeResult


def kind_of(name: str, results: Path) -> Kind:
    """Return the name of a result in messages."""
    result = RESULTS[name]
    return Kind(f"result of `minirobots {result.maker}`", f"run `{result.command(results)}`")


def read_experiment(name: str, results: Path) -> ExperimentResult:
    """Description of an experiment by `minirobots experiments`.

    Raises:
        UserError: there is no such result, or it is of another experiment.
    """
    path, kind = RESULTS[name].proof_in(results), kind_of(name, results)
    content = read_json(path, kind, ExperimentResult)
    if content.experiment != name:
        raise UserError(f"{path}: not a result of {name}; {kind.fix}")
    return content


def read_transfer(results: Path) -> TransferReport:
    """The table of `minirobots transfer`.

    Raises:
        UserError: there is no such result, or it is damaged.
    """
    path = RESULTS["transfer"].proof_in(results)
    return read_json(path, kind_of("transfer", results), TransferReport)


def read_run(name: str, results: Path) -> tuple[EpisodeResult, ...]:
    """Return the episodes of a run of `minirobots run`; none if it was not run.

    Raises:
        UserError: its summary is damaged.
    """
    result = RESULTS[name]
    if not result.exists(results):
        return ()
    path = result.proof_in(results)
    return read_json(path, kind_of(result.name, results), RunSummary).episodes
