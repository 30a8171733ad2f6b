"""Shared by the tests of analysis: short real runs of the main command."""

from dataclasses import replace
from functools import partial
from typing import Any

import matplotlib.pyplot as plt
import pytest

from agent.evaluation.rows import Row
from agent.study.report import Report
from analysis.profiles import Profile
from analysis.reading.results import RESULTS
from minirobots.reproduction import reproduce

# Everything on a small scale: few, short, but real runs.
TINY = Profile(
    name="tiny",
    runs=2,
    train_episodes=3000,
    greedy_points=6,
    drive_episodes={"paper": 4000, "moves": 20_000},
    single_episodes=1,
    pair_episodes=1,
    episode_limit_s=30.0,  # five bursts of recordings, in one of which a robot drives
    transfer_scenarios=("1a",),
    transfer_methods=("paper",),
    transfer_trainings=2,
    transfer_episodes=2,
)


def evaluate_seldom(patch):
    """Few evaluations on the way, of groups from few starts: policies so raw circle to the end."""
    patch.setattr("agent.moves.observe.MOVES_PER_KIND", 1)
    patch.setattr("agent.mdp.exact.MAX_STARTS", 1000)  # as many as pairs have, and more
    patch.setattr("agent.training.methods.replace", partial(replace, greedy_points=6))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark what needs the reproduction for CI: it trains and drives for half a minute, once."""
    for item in items:
        if "reproduction" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.ci)


@pytest.fixture(autouse=True)
def few_evaluations(monkeypatch):
    """The same while a test continues with a reproduction; its figures are closed."""
    evaluate_seldom(monkeypatch)
    yield
    plt.close("all")


@pytest.fixture(scope="session")
def tiny():
    """Profile of the session's reproduction."""
    return TINY


@pytest.fixture(scope="session")
def reproduction(tmp_path_factory):
    """A reproduction with everything small: results, figures and report."""
    out = tmp_path_factory.mktemp("reproduction")
    with pytest.MonkeyPatch.context() as patch:
        evaluate_seldom(patch)
        reproduce(out, TINY, seed=0, jobs=1, say=print)
    return out


@pytest.fixture(scope="session")
def results(reproduction):
    """Its results folder."""
    return reproduction / "results"


@pytest.fixture(scope="session")
def run_folder(results):
    """A run of two robots, one episode of 8 s."""
    return RESULTS["episodes_2_moves"].location(results)


@pytest.fixture(scope="session")
def recording(run_folder):
    """Recording of that episode."""
    return run_folder / "episodes" / "ep_000.rrd"


def transfer_row(scenario, policy, success, shield=False, mu=0.15):
    """A row of 50 episodes that end in success or collision; what else is measured is unknown."""
    measured: dict[str, Any] = {}
    for name, share in {"success": success, "collision": 1.0 - success}.items():
        low, high = max(share - 0.1, 0.0), min(share + 0.1, 1.0)
        measured |= {name: share, f"{name}_low": low, f"{name}_high": high}
    failing = round(50 * (1.0 - success))
    counts = {"episodes": 50, "planned": 50, "starts": 900, "failing_starts": failing}
    named = {"policy": policy, "scenario": scenario, "shield": shield, "mu": mu}
    return Row(**named, **counts, **measured)


@pytest.fixture
def write_transfer(tmp_path):
    """Writes the study of methods and returns its results folder."""

    def write(*rows):
        Report(seed=0, rows=rows).write(RESULTS["transfer"].proof_in(tmp_path))
        return tmp_path

    return write


@pytest.fixture(scope="session")
def row():
    """See `transfer_row`."""
    return transfer_row
