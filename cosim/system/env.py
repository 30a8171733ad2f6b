"""Any system of FMUs as an environment of Gymnasium: one, or many in threads.

    env = mr.SystemEnv("plant.ssp", actions={"valve.u": (0.0, 1.0)}, observations=["tank.level"],
                       reward=lambda before, action, after: -abs(after[0] - 2.0), step=0.1)

A step sets the inputs, lets the compiled master make its communication steps, and reads outputs.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from fmpy.model_description import ModelVariable
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from cosim.base.arguments import numbers, taken
from cosim.base.errors import shown
from cosim.fmi.fmu import Fmu
from cosim.model.config import whole_ratio
from cosim.system.graph import Component, Connection, GraphError, Node, find, load_fmus
from cosim.system.ssp.reader import read_system
from cosim.system.system import System, require_positive

Reward = Callable[[np.ndarray, np.ndarray, np.ndarray], float]
_LIMIT_STEPS = 1000
_MOST = float(np.finfo(np.float32).max)
_FLOATS = ("Real", "Float")


class SystemEnv(gym.Env[np.ndarray, np.ndarray]):
    """A system of FMUs with inputs as actions and outputs as observations.

    A reset goes back to the state after initialisation, which is saved once; FMUs that cannot save
    their states, or that begin with drawn parameters, are rebuilt.

    >>> import minirobots as mr
    >>> from cosim.system.graph import Component
    >>> from fmus.build import cached_fmu
    >>> motor = Component("motor", cached_fmu("VibrationMotor"))
    >>> ends = {"actions": {"motor.omega_des": (0.0, 900.0)}, "observations": ["motor.omega"]}
    >>> times = {"step": 0.5, "step_s": 1e-5}
    >>> env = mr.SystemEnv(([motor], []), reward="motor.omega", **ends, **times)
    >>> env.reset(seed=0)[0].tolist(), env.step([900.0])[0].round().tolist()
    ([0.0], [878.0])
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        system: str | Path | tuple[Sequence[Component], Sequence[Connection]],
        *,
        actions: Sequence[str] | Mapping[str, tuple[float, float]],
        observations: Sequence[str],
        reward: Reward | str,
        step: float,
        duration: float | None = None,
        terminated: Callable[[np.ndarray], bool] = lambda seen: False,
        parameters: Mapping[str, tuple[float, float]] = {},
        step_s: float = 1e-3,
        **options: Any,
    ) -> None:
        """Read the system.

        Args:
            system: .ssp or .ssd file, or components and connections.
            actions: inputs that nothing is connected to, as "component.input", or connectors of
                the file's outermost system, with their bounds; by default those that FMUs declare.
            observations: scalar variables "component.variable", in this order float32.
            reward: of a step, from observations before, the action, and observations after; or the
                name of a variable: its value after the step.
            step: time of an environment's step in s, a multiple of `step_s`.
            duration: simulated time in s after which an episode is truncated; by default that of
                the file's experiment, or 1000 steps.
            terminated: whether an episode ends with observations. It also ends when an FMU asks to
                end the simulation.
            parameters: "component.parameter" and bounds between which it is drawn uniformly at
                every reset.
            step_s: communication step in s.
            options: others of `cosim.system.system.System`, such as `algorithm`.

        Raises:
            GraphError: the system is invalid, or a name or bounds do not fit.
            FmuError: an FMU cannot be used.
        """
        start_s, stop_s, entries = 0.0, None, []
        if isinstance(system, str | Path):
            components, connections, entries, began_s, stop_s, _ = read_system(Path(system))
            start_s = began_s or 0.0
        elif isinstance(system, list | tuple) and len(system) == 2:
            components, connections = system
        else:
            raise GraphError(
                f"system = {shown(system)}: give a file (.ssp, .ssd), or components and connections"
            )
        require_positive("step", step)
        require_positive("step_s", step_s)
        self._ticks = whole_ratio("step", step, "step_s", step_s)
        self._fmus = load_fmus(components)
        self._components = list(components)
        drawn = taken("parameters", parameters, dict[str, Any], GraphError)
        self._parameters = {n: _checked_bounds(n, ends) for n, ends in drawn.items()}
        for name in ("inputs", "record", "start_s", "stop_s"):
            if name in options:
                raise GraphError(f"{name} is not for environments; leave it out")
        given = actions if isinstance(actions, Mapping) else {}
        asked = taken("actions", [*given] or actions, tuple[str, ...], GraphError)
        self._wiring = [_targets(name, entries) for name in asked]
        bounds = [
            _checked_bounds(name, given[name] if given else _declared(self._fmus, targets))
            for name, targets in zip(asked, self._wiring, strict=True)
        ]
        self._limit = _LIMIT_STEPS
        if duration is None and stop_s is not None:
            duration = stop_s - start_s
        if duration is not None:
            require_positive("duration", duration)
            self._limit = whole_ratio("duration", duration, "step", step)
        if not (callable(reward) or isinstance(reward, str)) or not callable(terminated):
            raise GraphError(
                "give a function or a variable as reward, and a function as terminated"
            )
        self._reward = reward if callable(reward) else lambda *_: self._read_reward()[0]
        self._terminated = terminated
        self._seen = taken("observations", observations, tuple[str, ...], GraphError)
        names = [target.target for targets in self._wiring for target in targets]
        inputs = {name: ([start_s], [_start(self._fmus, self._components, name)]) for name in names}
        self._inputs = {find(self._fmus, name) for name in names}
        if len(self._inputs) < len(names):
            raise GraphError(f"actions = {shown(asked)} set an input twice; leave one out")
        self._whole = [not _variable(self._fmus, name).type.startswith(_FLOATS) for name in names]
        self._rewards = [reward] if isinstance(reward, str) else []
        recorded = list(dict.fromkeys([*self._seen, *self._rewards]))
        self._made_of = connections, options | {
            "step_s": step_s, "start_s": start_s, "record": recorded, "inputs": inputs,
            "stop_s": None if duration is None else start_s + duration,
        }  # fmt: skip
        for name in self._parameters:
            self._parameter(name)
        low, high = np.array(bounds, dtype=np.float32).reshape(-1, 2).T
        self.action_space = spaces.Box(low, high, dtype=np.float32)
        self.observation_space = spaces.Box(-np.inf, np.inf, (len(self._seen),), np.float32)
        self._system: System | None = None
        self._make({})

    def _parameter(self, name: str) -> Node:
        node = find(self._fmus, name)
        if node in self._inputs:
            raise GraphError(f"parameter {name} has no effect, as an action sets it; leave it out")
        return node

    def _make(self, drawn: dict[str, float]) -> None:
        """Make the system, with some start values."""
        self.close()
        given = {self._parameter(name): value for name, value in drawn.items()}
        components = [
            c._replace(start={**c.start, **{n: v for (k, n), v in given.items() if k == c.name}})
            for c in self._components
        ]
        connections, options = self._made_of
        self._system = System(components, connections, **options)
        self._read = self._system.reader(self._seen)
        self._read_reward = self._system.reader(self._rewards)
        if self._system.can_go_back:
            self._system.keep()
        self._drawn, self._fresh, self._running = drawn, True, False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; `options={"parameters": {name: value}}` gives parameters of it.

        Raises:
            GraphError: an option or a parameter does not fit.
            FmuError: an FMU fails at the start.
        """
        super().reset(seed=seed)
        given = taken("options", options or {}, dict[str, Any], GraphError)
        drawn = {
            name: float(self.np_random.uniform(low, high))
            for name, (low, high) in self._parameters.items()
        }
        drawn |= taken("parameters", given.pop("parameters", {}), dict[str, float], GraphError)
        if given:
            raise GraphError(f"reset has no option {', '.join(given)}; give parameters")
        made = self._system is not None and drawn == self._drawn
        if made and self._system is not None and self._system.can_go_back:
            self._system.go_back()
        elif not (made and self._fresh):
            self._make(drawn)
        self._steps, self._running = 0, True
        self._observation = self._observed()
        return self._observation.copy(), {"parameters": drawn}

    def _observed(self) -> np.ndarray:
        return np.array(self._read(), dtype=np.float32)

    def step(self, action: Any) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold inputs for a step; actions beyond their bounds are cut.

        Raises:
            GraphError: the action is not finite numbers, or no episode is running.
            FmuError: an FMU failed; the next reset makes the system again.
        """
        if self._system is None or not self._running:
            raise GraphError("no episode is running; call reset before the next step")
        assert isinstance(self.action_space, spaces.Box)
        if (wanted := numbers(action, self.action_space.shape)) is None:
            raise GraphError(f"action = {shown(action)}: give {len(self._wiring)} finite numbers")
        cut = np.clip(wanted, self.action_space.low, self.action_space.high)
        self._running = self._fresh = False
        try:
            held = [
                target.factor * value + target.offset
                for value, targets in zip(cut.tolist(), self._wiring, strict=True)
                for target in targets
            ]
            pairs = zip(held, self._whole, strict=True)
            self._system.hold([round(value) if whole else value for value, whole in pairs])
            going_on = self._system.advance(self._ticks)
        except Exception:
            self.close()
            raise
        before, self._observation = self._observation, self._observed()
        self._steps += 1
        rewarded = self._reward(before, cut, self._observation)
        if (reward := numbers(rewarded, (), "fiub")) is None:
            raise GraphError(f"reward = {shown(rewarded)}: return a finite number")
        ended = not going_on or bool(self._terminated(self._observation))
        late = not ended and self._steps >= self._limit
        self._running = not (ended or late)
        return self._observation.copy(), float(reward), ended, late, {"time_s": self._system.time_s}

    def close(self) -> None:
        """Free the FMUs; `reset` makes them again."""
        if self._system is not None:
            self._system.close()
        self._system, self._running = None, False


class SystemVectorEnv(gym.vector.VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Instances of a system, stepped in threads; each row has the bits of a `SystemEnv`.

    >>> import minirobots as mr
    >>> from cosim.system.graph import Component
    >>> from fmus.build import cached_fmu
    >>> system = [Component("motor", cached_fmu("VibrationMotor"))], []
    >>> ends = {"actions": {"motor.omega_des": (0.0, 900.0)}, "observations": ["motor.omega"]}
    >>> times = {"step": 0.5, "step_s": 1e-5}
    >>> envs = mr.SystemVectorEnv(2, system, reward="motor.omega", **ends, **times)
    >>> envs.reset(seed=0)[0].tolist(), envs.step([[900.0], [600.0]])[0].round().tolist()
    ([[0.0], [0.0]], [[878.0], [579.0]])
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, num_envs: int, *arguments: Any, threads: int | None = None, **options: Any):
        """Make the instances.

        Args:
            num_envs: instances.
            arguments, options: of `SystemEnv`.
            threads: by default one per core.

        Raises:
            GraphError, FmuError: see `SystemEnv`; or an FMU allows one instance only.
        """
        for name, value in (("num_envs", num_envs), ("threads", 1 if threads is None else threads)):
            if taken(name, value, int, GraphError) < 1:
                raise GraphError(f"{name} = {value} must be at least 1")
        self.envs = [SystemEnv(*arguments, **options)]
        for name, fmu in self.envs[0]._fmus.items():
            if num_envs > 1 and fmu.interface.canBeInstantiatedOnlyOncePerProcess:
                raise GraphError(
                    f"the FMU of component {name} allows one instance in a process "
                    "(canBeInstantiatedOnlyOncePerProcess); make single environments in processes"
                )
        self.envs += [SystemEnv(*arguments, **options) for _ in range(num_envs - 1)]
        self.num_envs = num_envs
        self.single_observation_space = self.envs[0].observation_space
        self.single_action_space = self.envs[0].action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        threads = min(num_envs, threads or os.cpu_count() or 1)
        self._parts = [range(k, num_envs, threads) for k in range(threads)]
        self._pool = ThreadPoolExecutor(threads)
        self._done = np.zeros(num_envs, dtype=bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: Any = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin all episodes; one seed counts up over the instances."""
        if seed is None or isinstance(seed, int | np.integer):
            seed = [None if seed is None else int(seed) + k for k in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise GraphError(f"{len(seed)} seeds: give one to each of {self.num_envs} instances")
        begun = [env.reset(seed=s, options=options) for env, s in zip(self.envs, seed, strict=True)]
        self._done[:] = False
        infos: dict[str, Any] = {}
        for k, (_, info) in enumerate(begun):
            infos = self._add_info(infos, info, k)
        return np.stack([seen for seen, _ in begun]), infos

    def step(
        self, actions: Any
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step all instances; one that has ended begins again instead, with a reward of 0.

        Raises:
            GraphError: actions are not a row of finite numbers per instance; none is stepped then.
            FmuError: an FMU failed.
        """
        if (given := numbers(actions, self.action_space.shape or ())) is None:
            raise GraphError(
                f"actions = {shown(actions)}: give a row to each of {self.num_envs} instances, of "
                "finite numbers"
            )
        rows: list[Any] = [None] * self.num_envs

        def work(part: range) -> None:
            for k in part:
                env = self.envs[k]
                if self._done[k]:
                    seen, info = env.reset()
                    rows[k] = seen, 0.0, False, False, info
                else:
                    rows[k] = env.step(given[k])

        stepped = [self._pool.submit(work, part) for part in self._parts]
        wait(stepped)  # so that no instance is stepped still where another one has failed
        for each in stepped:
            each.result()
        infos: dict[str, Any] = {}
        for k, row in enumerate(rows):
            infos = self._add_info(infos, row[4], k)
        seen, rewards, terminated, truncated, _ = zip(*rows, strict=True)
        ends = np.array(terminated), np.array(truncated)
        self._done = ends[0] | ends[1]
        return np.stack(seen), np.array(rewards), *ends, infos

    def close_extras(self, **_: Any) -> None:
        """Free all FMUs."""
        self._pool.shutdown()
        for env in self.envs:
            env.close()


def _targets(name: str, entries: Sequence[Connection]) -> list[Connection]:
    """Return the inputs that an action sets: those of a connector of the system, or one."""
    return [e for e in entries if e.source == name] or [Connection(name, name)]


def _variable(fmus: Mapping[str, Fmu], name: str) -> ModelVariable:
    component, variable = find(fmus, name)
    return fmus[component].variables[variable]


def _declared(fmus: Mapping[str, Fmu], targets: Sequence[Connection]) -> tuple[float, float]:
    """Return the bounds of an action that its FMU declares."""
    target, variable = targets[0], _variable(fmus, targets[0].target)
    if len(targets) > 1 or variable.min is None or variable.max is None:
        raise GraphError(
            f"action {target.source}: its FMU declares no min and max; give bounds, as in "
            f'actions={{"{target.source}": (0.0, 1.0)}}'
        )
    ends = [(float(b) - target.offset) / target.factor for b in (variable.min, variable.max)]
    return min(ends), max(ends)


def _start(fmus: Mapping[str, Fmu], components: Sequence[Component], target: str) -> float:
    """Return the value that an input has at the start."""
    component, name = find(fmus, target)
    given = next(c.start for c in components if c.name == component)
    value = given.get(name, fmus[component].variables[name].start) or 0.0
    return float({"true": 1.0, "false": 0.0}.get(str(value).lower(), value))


def _checked_bounds(name: str, bounds: Any) -> tuple[float, float]:
    low, high = taken(f"bounds of {name}", bounds, tuple[float, float])
    if not -_MOST <= low <= high <= _MOST:
        raise GraphError(f"{name}: bounds ({low}, {high}) must be finite, the lower one first")
    return low, high
