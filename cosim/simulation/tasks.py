"""Many episodes at once: in the lanes of batches, batches in threads.

An episode is determined by its task alone, not by other episodes or their order.
"""

import contextlib
import queue
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from cosim.base.arguments import ConfigError
from cosim.base.provenance import digest_of, identity_of
from cosim.coupling.rl_step import Step, SupportsAct
from cosim.model.config import CoSimConfig
from cosim.model.scenario import Cell, Scenario
from cosim.recording.episode import EpisodeRecorder
from cosim.recording.file import Kept
from cosim.recording.series import Level
from cosim.simulation.batch import Batch, places_for, shared
from cosim.simulation.driving import DrivenEpisode, SupportsDrive, drives
from cosim.simulation.episode import RunningEpisode
from cosim.simulation.result import EpisodeResult, facts_of, result_of
from fmus.build import identity_of_fmu


class Record(NamedTuple):
    """How an episode is recorded; see `EpisodeRecorder`."""

    place: Path | Kept
    facts: dict[str, Any]
    level: Level = "default"
    viewer: str | None = None
    maps: bool = True  # whether those of the policy, if it has any, are drawn on the floor
    recording_id: str = ""  # by default that of the task


class EpisodeOrigin(msgspec.Struct, frozen=True):
    """All that determines an episode except for its policy and the code, as recordings keep it."""

    # scenario, config, starts, driver: of the task
    scenario: Scenario
    config: CoSimConfig
    starts: tuple[Cell, ...]
    driver: str
    # entropy, spawn_key: of its seed; the former as text, because it may have 128 bits
    entropy: str
    spawn_key: tuple[int, ...]
    motor_fmu: str


@dataclass(frozen=True)
class Task:
    """An episode to simulate."""

    scenario: Scenario
    fmu: Path
    config: CoSimConfig
    policy: SupportsAct | SupportsDrive
    starts: tuple[Cell, ...]
    seed: np.random.SeedSequence  # of the speed noise and of what the world draws
    record: Record | None = None
    # Sees every RL step, the episode, and the wall-clock time that it took so far, in s
    watch: Callable[[Step, RunningEpisode, float], None] = lambda step, episode, wall_s: None
    driver: str = "compiled"
    sampled: tuple[int, ...] | None = None

    @property
    def origin(self) -> EpisodeOrigin:
        """Return what determines the episode."""
        seed = str(self.seed.entropy), self.seed.spawn_key
        what = self.scenario, self.config, self.starts, self.driver
        return EpisodeOrigin(*what, *seed, identity_of_fmu(self.fmu))

    @cached_property
    def recording_id(self) -> str:
        """Identity of a recording: equal for equal episodes of equal policies.

        A policy that is known by nothing has another one in every task.
        """
        known = identity_of(self.policy) or uuid.uuid4().hex
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

    def batch(self, places: int) -> Batch:
        """Return a batch for tasks like this one."""
        return Batch(self.fmu, self.config, self.scenario.robots, places, self.driver)


def _episode(task: Task, batch: Batch, place: int) -> Generator[Any, Any, None]:
    """Yield an action, (N,) directions or (N, 2) set points, and take a step and its time, in turn.

    After a step its result is yielded if it was the last one, else None. Closing completes the
    recording.
    """
    kind = DrivenEpisode if drives(task.policy) else RunningEpisode
    parts = task.scenario, task.starts, task.seed, task.config, kind, task.sampled
    episode, wall_s = batch.begin(place, *parts), 0.0
    with contextlib.ExitStack() as stack:
        recorder = None
        if record := task.record:
            recorder = EpisodeRecorder(
                record.place,
                task.scenario,
                task.config,
                record.recording_id or task.recording_id,
                record.facts,
                level=record.level,
                viewer=record.viewer,
                policies=getattr(task.policy, "maps", list)() if record.maps else (),
                drawn=episode.drawn,
                sampled=episode.sampled,
            )
            stack.enter_context(recorder)
            recorder.set_property("origin", {"task": msgspec.json.encode(task.origin).decode()})
        while True:
            decision = episode.ask(task.policy)
            step, took_s = yield decision.action
            wall_s += took_s
            task.watch(step, episode, wall_s)
            result = result_of(episode, task.starts, wall_s) if step.outcome else None
            if recorder:
                rewards = getattr(task.policy, "reward_parts", None)
                recorder.write(step, decision, rewards and rewards(step, episode.arrived))
                if result:
                    recorder.set_property("result", facts_of(result))
            yield result


def _simulate(
    waiting: deque[tuple[int, Task]],
    places: int,
    may_begin: Callable[[], bool],
    stop: threading.Event,
) -> Iterator[tuple[int, EpisodeResult]]:
    """Simulate tasks that can share a batch, until none is left or may begin, or `stop` is set.

    Threads take them from `waiting` one by one.
    """
    going_on: dict[int, tuple[int, Generator[Any, Any, None]]] = {}
    free = list(range(places))
    batch: Batch | None = None
    try:
        while not stop.is_set():
            while free and may_begin():
                try:
                    number, task = waiting.popleft()
                except IndexError:  # another thread may have taken the last one
                    break
                batch = batch or task.batch(len(free))
                place = free.pop()
                going_on[place] = number, _episode(task, batch, place)
            if batch is None or not going_on:
                return
            began = time.perf_counter()
            steps = batch.advance({place: next(each) for place, (_, each) in going_on.items()})
            share_s = (time.perf_counter() - began) / len(going_on)
            for place, step in steps.items():
                number, each = going_on[place]
                result = each.send((step, share_s))
                if result is not None:
                    each.close()
                    del going_on[place]
                    free.append(place)
                    yield number, result
    finally:
        for _, each in going_on.values():
            each.close()
        if batch is not None:
            batch.close()


def simulate_tasks(
    tasks: Sequence[Task], threads: int, may_begin: Callable[[], bool] = lambda: True
) -> Iterator[tuple[int, EpisodeResult]]:
    """Simulate episodes; results in the order in which they end.

    Compiled code runs without the interpreter lock, so threads share the work without sharing
    anything else. On an interrupt, an error, or when the iterator is closed, episodes under way end
    after their RL step and complete their recordings, without result.

    Yields:
        Index of the task, and its result.
    """
    together: dict[object, deque[tuple[int, Task]]] = {}
    for number, task in enumerate(tasks):
        together.setdefault(task.batch_key, deque()).append((number, task))
    places = [room_for(some[0][1], len(some), threads) for some in together.values()]
    results: queue.SimpleQueue[tuple[int, EpisodeResult] | BaseException | None]
    results, stop = queue.SimpleQueue(), threading.Event()

    def work() -> None:
        try:
            for some, room in zip(together.values(), places, strict=True):
                for result in _simulate(some, room, may_begin, stop):
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


def room_for(task: Task, tasks: int, threads: int) -> int:
    """Return the places of a batch for some tasks like this one."""
    return places_for(task.driver, task.scenario.robots, tasks, threads)


def compile_kernels(task: Task, tasks: int, threads: int) -> None:
    """Compile the kernels for some tasks like this one, or load them from the cache."""
    task.batch(room_for(task, tasks, threads)).compile()
