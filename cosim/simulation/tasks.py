"""Many episodes at once: in the lanes of batches, batches in threads.

An episode is determined by its task alone, not by other episodes or their order.
"""

import contextlib
import queue
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from cosim.base.arguments import ConfigError
from cosim.base.provenance import digest_of, identity_of
from cosim.coupling.rl_step import Step, SupportsAct
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Cell, Scenario
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.file import Kept
from cosim.simulation.batch import Batch, places_for, shared
from cosim.simulation.driving import DrivenEpisode, SupportsDrive, drives
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.result import EpisodeResult, facts_of, result_of
from fmus.build import identity_of_fmu


def recorder_of(
    episode: RunningEpisode,
    place: Path | Kept,
    recording_id: str,
    facts: dict[str, Any],
    **how: Any,
) -> EpisodeRecorder:
    """Return what records an episode that has begun; arguments as of `EpisodeRecorder`."""
    own = {"drawn": episode.drawn, "sampled": episode.sampled}
    known = episode.scenario, episode.config, recording_id, facts
    return EpisodeRecorder(place, *known, **own, **how)


class EpisodeOrigin(msgspec.Struct, frozen=True):
    """All that determines an episode except for its policy and the code, as recordings keep it.

    Attributes:
        scenario, config, starts, driver: of the task.
        entropy, spawn_key: of its seed; the former as text, because it may have 128 bits.
        motor_fmu: identity of the FMU, see `fmus.build.identity_of_fmu`.
    """

    scenario: Scenario
    config: CoSimConfig
    starts: tuple[Cell, ...]
    driver: str
    entropy: str
    spawn_key: tuple[int, ...]
    motor_fmu: str


@dataclass(frozen=True)
class Task:
    """An episode to simulate.

    Attributes:
        policy: acts or drives; the values of its decisions and its rewards are recorded.
        starts: start cell of each robot.
        seed: of the speed noise and of what the world draws.
        recorder: opens the recording of an episode that has begun, which gets every RL step; None
            for none.
        watch: sees every RL step, the episode, and the wall-clock time that it took so far, in s.
        driver: of the co-simulation.
        sampled: indices of the robots with kept signals, see `RunningEpisode`.
    """

    scenario: Scenario
    fmu: Path
    config: CoSimConfig
    policy: SupportsAct | SupportsDrive
    starts: tuple[Cell, ...]
    seed: np.random.SeedSequence
    recorder: Callable[[RunningEpisode], EpisodeRecorder] | None = None
    watch: Callable[[Step, RunningEpisode, float], None] = lambda step, episode, wall_s: None
    driver: str = "compiled"
    sampled: tuple[int, ...] | None = None

    @property
    def origin(self) -> EpisodeOrigin:
        """Return what determines the episode."""
        seed, fmu = self.seed, identity_of_fmu(self.fmu)
        return EpisodeOrigin(
            self.scenario,
            self.config,
            self.starts,
            self.driver,
            str(seed.entropy),
            seed.spawn_key,
            fmu,
        )

    @cached_property
    def recording_id(self) -> str:
        """Identity of a recording: equal for equal episodes of equal policies.

        A policy that is known by nothing has another one in every task.
        """
        digest = getattr(self.policy, "digest", None)
        known = digest() if callable(digest) else identity_of(self.policy) or uuid.uuid4().hex
        origin = msgspec.structs.replace(self.origin, config=self.config.unsourced)
        return f"{self.scenario.name}-{digest_of(origin, known)}"

    @classmethod
    def again(cls, origin: EpisodeOrigin, fmu: Path, policy: SupportsAct | SupportsDrive) -> "Task":
        """Return the task of a recorded episode; refuses another motor FMU than then."""
        if origin.motor_fmu != identity_of_fmu(fmu):
            raise ConfigError(
                f"motor FMU {fmu} is not the one that was recorded; name that by --motor-fmu"
            )
        seed = np.random.SeedSequence(int(origin.entropy), spawn_key=origin.spawn_key)
        parts = origin.scenario, fmu, origin.config, policy, origin.starts, seed
        return cls(*parts, driver=origin.driver)

    @property
    def batch_key(self) -> tuple[object, ...]:
        """Equal for tasks that can share a batch."""
        return shared(self.config), self.fmu, self.driver, self.scenario.robots


class ActiveEpisode:
    """A running episode, with its policy and its recorder."""

    def __init__(self, number: int, task: Task, batch: Batch, place: int) -> None:
        self.number = number
        self._task = task
        self._wall_s = 0.0
        kind = DrivenEpisode if drives(task.policy) else RunningEpisode
        self.episode = batch.begin(
            place, task.scenario, task.starts, task.seed, task.config, kind, task.sampled
        )
        self._open = contextlib.ExitStack()
        self._recorder = task.recorder and self._open.enter_context(task.recorder(self.episode))
        if self._recorder is not None:
            self._recorder.set_property(
                "origin", {"task": msgspec.json.encode(task.origin).decode()}
            )

    def act(self) -> np.ndarray:
        """Return what the policy decides: (N,) direction indices, or (N, 2) set points."""
        self._decision = self.episode.ask(self._task.policy)
        return self._decision.action

    def take(self, step: Step, wall_s: float) -> None:
        """Watch and record an RL step that took so long."""
        self._wall_s += wall_s
        self._task.watch(step, self.episode, self._wall_s)
        if self._recorder is not None:
            parts = getattr(self._task.policy, "reward_parts", None)
            rewards = parts and parts(step, self.episode.arrived)
            self._recorder.write(step, self._decision, rewards)
            if step.outcome:
                self._recorder.set_property("result", facts_of(self.result()))

    def result(self) -> EpisodeResult:
        """Return the result so far."""
        return result_of(self.episode, self._task.starts, self._wall_s)

    def close(self) -> None:
        """Complete the recording."""
        self._open.close()


class _Queue:
    """Tasks that can share a batch; threads take them one by one."""

    def __init__(self, tasks: list[tuple[int, Task]], places: int) -> None:
        self._waiting = deque(tasks)
        self._places = places

    def run(
        self, may_begin: Callable[[], bool], stop: threading.Event
    ) -> Iterator[tuple[int, EpisodeResult]]:
        """Simulate tasks in one batch, until none is left or may begin, or until `stop` is set."""
        going_on: dict[int, ActiveEpisode] = {}
        free = list(range(self._places))
        batch: Batch | None = None
        try:
            while not stop.is_set():
                while free and may_begin():
                    try:
                        number, task = self._waiting.popleft()
                    except IndexError:  # another thread may have taken the last one
                        break
                    batch = batch or _new_batch(task, len(free))
                    place = free.pop()
                    going_on[place] = ActiveEpisode(number, task, batch, place)
                if batch is None or not going_on:
                    return
                began = time.perf_counter()
                steps = batch.advance({k: active.act() for k, active in going_on.items()})
                share_s = (time.perf_counter() - began) / len(going_on)
                for place, step in steps.items():
                    going_on[place].take(step, share_s)
                    if step.outcome:
                        ended = going_on.pop(place)
                        ended.close()
                        free.append(place)
                        yield ended.number, ended.result()
        finally:
            for active in going_on.values():
                active.close()
            if batch is not None:
                batch.close()


def _new_batch(task: Task, places: int) -> Batch:
    return Batch(task.fmu, task.config, task.scenario.robots, places, task.driver)


def simulate_tasks(
    tasks: Sequence[Task], threads: int, may_begin: Callable[[], bool] = lambda: True
) -> Iterator[tuple[int, EpisodeResult]]:
    """Simulate episodes; results in the order in which they end.

    Compiled code runs without the interpreter lock, so threads share the work without sharing
    anything else. On an interrupt, an error, or when the iterator is closed, episodes under way end
    after their RL step and complete their recordings, without result.

    Yields:
        (index of the task, its result).
    """
    together: dict[object, list[tuple[int, Task]]] = {}
    for number, task in enumerate(tasks):
        together.setdefault(task.batch_key, []).append((number, task))
    queues = []
    for some in together.values():
        first = some[0][1]
        room = places_for(first.driver, first.scenario.robots, len(some), threads)
        queues.append(_Queue(some, room))
    results: queue.SimpleQueue[tuple[int, EpisodeResult] | BaseException | None]
    results, stop = queue.SimpleQueue(), threading.Event()

    def work() -> None:
        try:
            for some in queues:
                for result in some.run(may_begin, stop):
                    results.put(result)
        except BaseException as error:
            results.put(error)
        finally:
            results.put(None)

    with ThreadPoolExecutor(threads) as pool:
        try:
            for _ in range(threads):
                pool.submit(work)
            working = threads
            while working:
                done = results.get()
                if isinstance(done, BaseException):
                    raise done
                if done is None:
                    working -= 1
                else:
                    yield done
        finally:
            stop.set()


def compile_kernels(task: Task, tasks: int, threads: int) -> None:
    """Compile the kernels for some tasks like this one, or load them from the cache."""
    _new_batch(task, places_for(task.driver, task.scenario.robots, tasks, threads)).compile()
