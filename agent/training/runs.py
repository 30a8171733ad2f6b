"""Training runs in folders: many seeds of one configuration, resumed run by run.

    experiment.json      configuration of all runs
    training.rrd         mean and scatter over the runs, if there are several
    run_000/policy.npz   trained policy (with policy.json next to it), written last
    run_000/training.npz learning curves (`agent.training.loop.TrainingLog`)
    run_000/training.rrd the same for the Rerun viewer

Where runs are computed is `cosim.base.backends`, the command `minirobots train`.
"""

from pathlib import Path

import msgspec
import numpy as np

from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.moves.model import ObservedMoves
from agent.training.loop import TrainingLog, learn
from agent.training.methods import find_method
from agent.training.policy import Policy, PolicyConfig, Seed
from agent.training.recording import write_training
from agent.training.settings import LearningConfig
from agent.training.store import POLICY_FILE, load_run, save_run
from cosim.base.backends import sweep
from cosim.base.errors import UserError
from cosim.base.jobs import PROCESSES, Workers
from cosim.base.progress import Progress, silent
from cosim.base.provenance import digest_of
from cosim.base.reading import Kind, read_json
from cosim.base.storage import write_json
from cosim.model.scenario import Scenario

EXPERIMENT_FILE = "experiment.json"
RECORDING_FILE = "training.rrd"
_FILE = Kind("configuration of runs", "choose another --out")


class RunsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Configuration of a folder of runs that differ only in their seeds, kept in the folder."""

    scenario: Scenario
    process: ProcessConfig
    learning: LearningConfig
    seed: int
    runs: int
    moves: ObservedMoves | None = None
    method: str = "paper"
    schema_version: int = 1

    def configs(self) -> list[PolicyConfig]:
        """One configuration per run; seeds are spawned from the common seed."""
        made = self.scenario, self.process, self.learning
        seeds = map(Seed.of, np.random.SeedSequence(self.seed).spawn(self.runs))
        return [PolicyConfig(*made, seed, self.moves, self.method) for seed in seeds]


def run_name(run: int) -> str:
    """Name of the folder of a run."""
    return f"run_{run:03d}"


def make_runs(
    common: RunsConfig,
    out: Path,
    *,
    where: Workers = PROCESSES,
    progress: Progress = silent,
    task: str = "training",
) -> list[tuple[Policy, TrainingLog]]:
    """Train the runs of a configuration that its folder lacks, and return all in their order.

    Each is written as soon as it is ready; progress is reported under the name `task`.
    """
    out = out.absolute()
    build_process(common.scenario, common.process)  # refuse here, not in every worker
    own = find_method(common.method).own
    configs, results = common.configs(), dict[int, tuple[Policy, TrainingLog]]()
    _require_same(out / EXPERIMENT_FILE, common)
    folders = [out / run_name(number) for number in range(len(configs))]
    for number, (folder, config) in enumerate(zip(folders, configs, strict=True)):
        folder.mkdir(exist_ok=True)
        if (found := load_run(folder)) is None:
            continue
        if own:
            raise UserError(
                f"{folder / POLICY_FILE}: is of method {common.method}, whose code may have "
                "changed since, so that its runs cannot be continued; choose another --out"
            )
        if found[0].config != config:
            raise UserError(
                f"{folder / POLICY_FILE}: was trained by another version with other results; "
                "choose another --out to train again"
            )
        results[number] = found
    missing = [number for number in range(len(configs)) if number not in results]
    ended = sweep(learn, [configs[number] for number in missing], where)
    for count, (index, (policy, log)) in enumerate(ended, 1):
        number = missing[index]
        facts = {
            "scenario": common.scenario.name,
            "seed": common.seed,
            "run": number,
            "config_digest": digest_of(configs[number]),
        }
        write_training(folders[number] / RECORDING_FILE, policy, log, facts)
        save_run(folders[number], policy, log)
        results[number] = policy, log
        progress(task, count, len(missing), f"{count}/{len(missing)}")
    return [results[number] for number in range(len(configs))]


def policy_paths(out: Path) -> list[Path]:
    """Policies of all finished runs in a folder of runs, in order."""
    return sorted(out.glob(f"run_*/{POLICY_FILE}"))


def _require_same(path: Path, config: RunsConfig) -> None:
    """Make a folder that of a configuration, or refuse one of another."""
    if not path.exists():
        write_json(path, config)
    elif read_json(path, _FILE, RunsConfig) != config:
        raise UserError(
            f"{path}: belongs to another configuration; give the options it was started with or "
            "choose another --out"
        )
