"""Commands killed at random moments: the same command then ends as if nothing had been.

Moments are shares of the time that the undisturbed command takes; they are seeded and printed.
"""

import random
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.faults.killing import CACHED, REMADE, Case, Workplace, cases, errors_of

MOMENTS = 12
ONE_BY_ONE = ("training", "sweep", "evaluation", "study", "report", "FMU")
# Whose results a command reads.
NEEDED = {"evaluation": "training", "report": "reproduction"}
PARTIAL = {
    "training": "experiment.json",
    "sweep": "experiment.json",
    "evaluation": "results.sqlite",
}
# Commands that keep rows of episodes.
WRITERS = {
    "evaluate": ("--policy", "shortest", "--scenario", "1a", "--starts", "6", "--recordings", "0"),
}
GROWING = {"summary.json", "timings.json", "results.sqlite"}
ENDS = {signal.SIGINT: 130, signal.SIGTERM: 143}


def moments(name: str) -> list[float]:
    return [random.Random(f"{name} {k}").random() for k in range(MOMENTS)]


@dataclass
class Undisturbed:
    """A command, how long it takes in s at best, and what its files then say."""

    case: Case
    duration_s: float
    files: dict[str, Any]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> Callable[[str], Undisturbed]:
    """Runs a command once, when the first test asks for it."""
    found: dict[str, Undisturbed] = {}
    folders = {name: tmp_path_factory.mktemp(name) for name in NEEDED.values()}
    known = cases(folders["training"] / "out", folders["reproduction"] / "out")

    def of(name: str) -> Undisturbed:
        if name not in found:
            if name in NEEDED:
                of(NEEDED[name])
            place = Workplace(folders.get(name) or tmp_path_factory.mktemp(name), known[name])
            duration_s, _ = place.run()
            print(f"{name} takes {duration_s:.1f} s")
            found[name] = Undisturbed(place.case, duration_s, place.files())
            assert found[name].files
        return found[name]

    return of


def check(place: Workplace, whole: Undisturbed) -> None:
    """Run the command again, and compare."""
    duration_s, errors = place.run()
    whole.duration_s = min(whole.duration_s, duration_s)
    assert not REMADE.search(errors)
    assert place.files() == whole.files
    left = [p for p in place.cache.rglob(".*.tmp-*") if p.is_file()]
    assert left == []


@pytest.mark.faults
@pytest.mark.parametrize("moment", range(MOMENTS))
@pytest.mark.parametrize("name", ONE_BY_ONE)
def test_killed_once(undisturbed, tmp_path, name, moment):
    whole = undisturbed(name)
    share = moments(name)[moment]
    print(f"{name} is killed after {share:.3f} of {whole.duration_s:.1f} s")
    place = Workplace(tmp_path, whole.case)
    place.kill(share * whole.duration_s)
    for file, content in place.files().items():  # which can all be read
        if content is not None and Path(file).name not in GROWING:
            assert content == whole.files[file], file
    check(place, whole)


@pytest.mark.faults
@pytest.mark.parametrize("name", ["kernels", "reproduction"])
def test_killed_again_and_again(undisturbed, tmp_path, name):
    whole = undisturbed(name)
    place = Workplace(tmp_path, whole.case)
    for share in (moment / 3.0 for moment in moments(name)):  # it continues from kill to kill
        print(f"{name} is killed after {share:.3f} of {whole.duration_s:.1f} s")
        place.kill(share * whole.duration_s)
    check(place, whole)


@pytest.mark.faults
@pytest.mark.parametrize("how", ENDS)
@pytest.mark.parametrize("name", PARTIAL)
def test_interrupted(undisturbed, tmp_path, name, how):
    """Status and mark of what is there; the same command continues."""
    whole = undisturbed(name)
    place = Workplace(tmp_path, whole.case)
    began = place.start()
    seen = PARTIAL[name]
    while not (place.out.exists() and list(place.out.glob(seen))):
        assert began.poll() is None, "it ended before it could be interrupted"
    began.send_signal(how)
    _, errors = began.communicate()
    assert began.returncode == ENDS[how], errors
    assert "interrupted\n" in errors  # loky may tell after it what it cleans up
    assert "Traceback" not in errors
    marks = {"summary.json"}
    assert not marks.intersection(path.name for path in place.out.rglob("*"))
    assert not list(place.out.rglob(".*.tmp-*"))
    check(place, whole)


@pytest.mark.faults
def test_four_at_once_with_an_empty_cache(tmp_path):
    """Kernels, FMU, calibration and policy are made by one of them, and all find the same."""
    arguments = ("--method", "paper", "--train-episodes", "20000", "--time-limit", "4")
    case = Case(("-m", "minirobots", "run", "--out", "OUT", *arguments), CACHED)
    places = [Workplace(tmp_path / str(k), case) for k in range(5)]
    for place in places:
        place.environment["MINIROBOTS_CACHE"] = str(places[0].cache)
    together = [place.start() for place in places[:4]]
    said = [process.communicate()[1] for process in together]
    assert [process.returncode for process in together] == [0] * 4, said
    _, errors = places[4].run()
    for text in (*said, errors):
        assert not REMADE.search(text)
    files = [place.files() for place in places]
    assert all(found == files[0] for found in files)


@pytest.mark.faults
@pytest.mark.parametrize("name", WRITERS)
def test_two_writers_at_once_lose_nothing(tmp_path, name):
    out = ("--jobs", "1", "--out", "OUT")
    place = Workplace(tmp_path, Case(("-m", "minirobots", name, *WRITERS[name], *out)))
    together = [place.start(), place.start()]
    said = [errors_of(process) for process in together]
    assert [process.returncode for process in together] == [0, 0], said
    files = place.files()
    place.run()
    assert place.files() == files
