"""Times training: numba against plain C, against a Gymnasium loop, and against the paper.

Scenario 4 over Section V's 5 000 000 episodes, in turn, by the processor time of the one thread, so
that ratios hold on a busy machine; only `--all` is wall-clock time.
"""

import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np

import agent.envs
from agent.mdp.config import ProcessConfig
from agent.mdp.interpretations import build_process
from agent.training.learning import build_learning, initial_state
from agent.training.qlearning import advance
from agent.training.runs import RunsConfig, make_runs
from agent.training.settings import LearningConfig
from benchmarks.timing import best_s
from cosim.base.command import Checked, Count
from cosim.base.jobs import Workers
from cosim.model.scenario_file import PAPER, find_scenario
from tests.references.qlearning_c import build_reference, reference_state, train_reference

PAPER_S = 600.0  # "execution time about 10 min", Section V
GYMNASIUM_STEPS = 50_000
SECTION_V = LearningConfig()


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
    repeats: Count = 3
    """Timed trainings of each kind; the fastest counts."""
    all: bool = False
    """Also time 20 runs of each of the five scenarios on all cores (a few minutes)."""


def gymnasium_steps_per_s() -> float:
    """Steps per second of the loop that one writes with Gymnasium, numpy and a Q table."""
    assert agent.envs  # its import registers the ids
    env = gym.make("MiniRobots/SingleA-v0")
    q = np.zeros((30, 30, 8), dtype=np.float32)
    random = np.random.default_rng(0)
    state = tuple(env.reset(seed=0)[0])
    began = time.thread_time()
    for _ in range(GYMNASIUM_STEPS):
        explore = random.random() < SECTION_V.epsilon
        action = random.integers(8) if explore else q[state].argmax()
        seen, reward, terminated, truncated, _ = env.step(action)
        after = tuple(seen)
        target = float(reward) + (0.0 if terminated else SECTION_V.gamma * q[after].max())
        # Eq. (7)
        q[*state, action] += SECTION_V.eta * (target - q[*state, action])
        state = tuple(env.reset()[0]) if terminated or truncated else after
    return GYMNASIUM_STEPS / (time.thread_time() - began)


def measure(options: Options) -> dict[str, float]:
    scenario, learning = find_scenario("4"), build_learning(SECTION_V)
    process, steps = build_process(scenario, ProcessConfig()), 0

    def numba() -> None:
        nonlocal steps
        state = initial_state(process, SECTION_V, 0)
        advance(process, learning, state, SECTION_V.episodes)
        steps = state.agent_steps

    with tempfile.TemporaryDirectory() as folder:
        library = build_reference(Path(folder))

        def plain_c() -> None:
            state = reference_state(scenario, initial_state(process, SECTION_V, 0).random)
            train_reference(library, scenario, learning, state, SECTION_V.episodes)

        advance(process, learning, initial_state(process, SECTION_V, 0), 10)  # compile
        seconds, seconds_c = best_s(options.repeats, numba, plain_c)
    gymnasium = max(gymnasium_steps_per_s() for _ in range(options.repeats))
    figures = {
        "seconds_5e6": seconds,
        "agent_steps_per_s": steps / seconds,
        "seconds_5e6_c": seconds_c,
        "ratio_numba_to_c": seconds / seconds_c,
        "gymnasium_steps_per_s": gymnasium,
        "ratio_to_gymnasium": steps / seconds / gymnasium,
        "ratio_to_paper": PAPER_S / seconds,
    }
    if options.all:
        figures["seconds_five_scenarios_20_runs"] = seconds_of_all()
    return figures


def seconds_of_all() -> float:
    """Seconds for 20 runs of each scenario of the paper on all cores, policies saved."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for name in PAPER:
            experiment = RunsConfig(
                find_scenario(name), ProcessConfig(), SECTION_V, seed=0, runs=20
            )
            make_runs(experiment, Path(folder) / name, where=Workers(backend="threads"))
    return time.perf_counter() - began
