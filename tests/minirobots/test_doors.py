"""Every way in makes the same case of the same arguments, and refuses what changes nothing.

Ways in are functions, commands, environments and pages. What they would simulate or train is
caught before it is, and compared.
"""

import inspect
from dataclasses import fields
from typing import Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import agent
import minirobots as mr
from agent.envs import WorldRange, parallel_env
from agent.moves.observe import source_digest
from agent.training.methods import method_config
from agent.web.page import write_page
from cosim.base.errors import UserError
from cosim.base.provenance import digest_of
from cosim.recording.series import with_bursts
from cosim.simulation.options import EpisodeOptions, SimulationOptions
from fmus.build import cached_fmu, identity_of_fmu
from minirobots.commands.policies import Train

ALONE = "columns = 14\nrows = 14\n[[robots]]\ntarget = [5, 3]\nstarts = [[3, 3]]\n"
PAIR = ALONE + "[[robots]]\ntarget = [5, 10]\nstarts = [[3, 10]]\n"
WORLD = "[world]\nrestitution = 0.1\nmotor_spread = 0.02\n"
WALL = WORLD + "obstacles = [[11, 7]]\n"


class CaughtError(UserError):
    """Something is about to be simulated or trained."""


@pytest.fixture(scope="module")
def ways(command, tmp_path_factory):
    """Return what each way in is about to simulate or train with options by their names."""
    found: list[Any] = []
    moves = method_config("moves", "1a").moves
    assert moves is not None

    def catch(*given: Any, **more: Any) -> Any:
        found.append((given, more))
        raise CaughtError("caught")

    def observed(config, fmu, _, worlds, cell_m):
        source = source_digest(config, fmu, worlds)
        own = {"rl_step_s": config.timing.rl_step_s, "through": config.through}
        return msgspec.structs.replace(moves, source=source, cell_m=cell_m, **own)

    def python(function, *arguments):
        def called(**options):
            found.clear()
            with pytest.raises(CaughtError):
                function(*arguments, **options)
            return found[0]

        return called

    def commanded(name, *arguments):
        def called(**options):
            found.clear()
            ended = command(name, *arguments, *flags(options))
            if not found:
                raise UserError(ended.stderr)
            return found[0]

        return called

    def train(scenario, method, **options):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("agent.training.store.find_or_make", catch)
            agent.train(scenario, method=method, progress=None, **options)

    def not_measured(config, *_, **__):
        return config if config.steering.drive_speed_m_s else config.commanded

    def page(scenario, method, **options):
        more = {name: options.pop(name) for name in ("seed", "worlds") if name in options}
        write_page(folder / "p.html", scenario, SimulationOptions(**options), method=method, **more)

    folder = tmp_path_factory.mktemp("doors")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for place in ("cosim.calibration.measuring", "agent.training.methods"):
            patch.setattr(f"{place}.calibrated", not_measured)
        stopping = "cosim.calibration.shielding.with_stopping_distance"
        patch.setattr(stopping, lambda config, *_: config)
        patch.setattr("agent.training.methods.cached_moves", observed)
        for place in ("agent.evaluation.run", "agent.study.store"):
            patch.setattr(f"{place}.compile_kernels", lambda *_: None)
        for place in (
            "cosim.simulation.simulate",
            "agent.evaluation.run",
            "agent.evaluation.cases",
        ):
            patch.setattr(f"{place}.simulate_tasks", catch)
        patch.setattr("agent.web.page._world", catch)
        patch.setattr("agent.envs.dynamics.Batch", catch)
        patch.setattr("agent.experiments.run.make_runs", catch)
        patch.setattr("cosim.simulation.ahead.is_compiled", lambda _: True)

        def of(scenario: str, method: str) -> dict[str, Any]:
            path = folder / f"{digest_of(scenario)}.toml"
            path.write_text(scenario)
            on = "--scenario", path
            more: Any = {"starts": 1, "progress": None}
            return {
                "run": commanded("run", *on, "--method", method),
                "evaluate": python(lambda **o: mr.evaluate(method, path, **more, **o)),
                "study": python(lambda **o: mr.study(method, path, episodes=1, progress=None, **o)),
                "command": commanded("evaluate", method, *on, "--starts", 1),
                "web": python(lambda **o: page(path, method, **o)),
                "environment": python(lambda **o: parallel_env(path, cosim=True, **o)),
                "train": python(lambda **o: train(path, method, **o)),
                "train command": commanded("train", *on, "--method", method, "--out", folder / "t"),
            }

        yield of, folder


def flags(options):
    """Return the arguments of a command line for options by their names in Python."""
    for name, value in options.items():
        yield "--" + name.replace("motor_parameters", "motor_parameter").replace("_", "-")
        if isinstance(value, dict):
            yield from (f"{key}={number!r}" for key, number in value.items())
        elif isinstance(value, list | tuple):
            yield from value
        elif value is not True:
            yield value


def setup_of(scenario, config, fmu):
    """Return what determines an episode but for its policy and what is drawn."""
    return scenario, with_bursts(config, "none").unsourced, identity_of_fmu(fmu)


def policy_of(config):
    """Return what determines a policy but for the seed of its training."""
    return config.scenario, config.process, config.method, config.moves


def setup_and_policy(way, found):
    """Return what a way in makes: the setup of an episode and the policy, None without one."""
    (given, _) = found
    if way == "web":
        return setup_of(*given[2]), policy_of(given[1].config)
    if way == "environment":
        return setup_of(given[0], given[1], given[0])[1:], None
    if way == "train":
        return None, policy_of(given[0])
    if way == "train command":
        return None, policy_of(given[0])
    task = given[0][0]
    return setup_of(task.scenario, task.config, task.fmu), policy_of(task.policy.config)


MACHINES = st.one_of(
    st.fixed_dictionaries(
        {"preset": st.sampled_from(("kilobot", "pogobot-brush", "thesis", "droplet"))}
    ),
    st.fixed_dictionaries(
        {"motor_parameters": st.fixed_dictionaries({"J": st.floats(4e-9, 8e-9)})}
    ),
)
WORLDS = st.sampled_from(({}, {"world": WORLD}, {"world": WALL}))
DRIVING = st.fixed_dictionaries(
    {},
    optional={
        "mu": st.floats(0.1, 0.4),
        "noise": st.floats(0.0, 0.1),
        "rl_step": st.sampled_from((1.0, 2.0)),
        "through": st.just(True),
        "time_limit": st.sampled_from((40.0, 100.0)),
        "reaction": st.just(True),
    },
)


@pytest.mark.long
@settings(max_examples=5)
@given(MACHINES, WORLDS, DRIVING)
def test_every_way_in_makes_the_same_case(ways, machine, world, driving):
    of, folder = ways
    if machine == {"preset": "droplet"}:
        driving = {name: driving[name] for name in driving if name != "noise"}  # no speed loop
    if machine == {"preset": "pogobot-brush"}:
        world = {}  # no restitution on legs
    if world:
        (folder / "world.toml").write_text(world["world"])
        world = {"world": folder / "world.toml"}
    of_method, cases = of(ALONE, "fastest"), {}
    for way, make in of_method.items():
        if way == "train command":
            continue
        options = machine | world | ({} if way == "train" else driving)
        if way == "train" and world and (folder / "world.toml").read_text() == WORLD:
            with pytest.raises(UserError, match="world has no effect"):
                make(**options)
            options = machine
        cases[way] = setup_and_policy(way, make(**options))
    setup, policy = cases.pop("run")
    assert cases.pop("environment")[0] == setup[1:]
    assert cases.pop("train")[1] == policy
    assert cases == dict.fromkeys(cases, (setup, policy))
    assert setup[0] == policy[0]
    learnt = of(ALONE, "moves")
    (experiment, *_), _ = learnt["train command"](**machine)
    (config, *_), _ = learnt["train"](**machine)
    assert policy_of(experiment) == policy_of(config)


# Another value of each option, and of which ways in it is one.
OTHER = {
    "preset": "kilobot", "mu": 0.2, "noise": 0.01, "dt": 2e-5, "communication_step": 2e-5,
    "reaction": True, "motor_parameters": {"J": 6e-9}, "rl_step": 1.0, "through": True,
    "speed": 3.0, "on_collision": "continue", "shield": True, "open_loop": ("motors",),
    "time_limit": 100.0, "seed": 3, "record": "summary", "signals": [1], "driver": "reference",
    "motor_fmu": "other.fmu", "world": "wall.toml",
    "episodes": 1000, "again": True, "eta": 0.2, "worlds": WorldRange(restitution=(0.1, 0.2)),
}  # fmt: skip


def shown(found):
    """Return everything of what is caught, for comparison."""
    given, more = found
    rows: list[Any] = []
    for one in given:
        if isinstance(one, list):  # of tasks
            records = [task.record and task.record.level for task in one]
            policies = [repr(task.policy.config) for task in one]
            rows.append(([t.origin for t in one], records, policies, [t.sampled for t in one]))
        else:
            rows.append(repr(getattr(one, "config", one)))
    return rows, {name: value for name, value in more.items() if name != "progress"}


@pytest.mark.long
@pytest.mark.parametrize("way", ["run", "evaluate", "study", "command", "web", "environment"])
def test_each_option_changes_what_a_way_in_makes_or_is_refused(ways, way):
    changes(
        ways,
        way,
        "shortest",
        [f.name for f in fields(EpisodeOptions if way == "run" else SimulationOptions)],
    )


@pytest.mark.parametrize("method", ["moves", "shortest"])
def test_each_option_changes_what_is_trained_or_is_refused(ways, method):
    own = ("scenario", "method", "progress", "settings")
    options = [name for name in inspect.signature(agent.train).parameters if name not in own]
    options.append("eta")
    changes(ways, "train", method, options)


def test_each_option_of_a_machine_changes_what_the_command_trains(ways):
    given = ("preset", "world", "motor_fmu", "motor_parameters", "seed")
    assert {*given} <= {field.name for field in fields(Train)}
    changes(ways, "train command", "moves", given)
    of, _ = ways
    for name in ("motor_fmu", "motor_parameters", "preset"):
        with pytest.raises(UserError, match=f"{name}.* has no effect"):
            of(PAIR, "paper")["train command"](
                **{name: "thesis" if name == "preset" else OTHER[name]}
            )


def changes(ways, way, method, options):
    """Demand that another value of each option changes what a way in makes, or is refused."""
    of, folder = ways
    (folder / "wall.toml").write_text(WALL)
    (folder / "other.fmu").write_bytes(cached_fmu().read_bytes() + b"other")
    make = of(PAIR, method)[way]
    usual, refused = shown(make()), []
    for name in options:
        try:
            assert shown(make(**{name: OTHER[name]})) != usual, name
        except CaughtError:
            raise
        except UserError as error:
            refused.append(name)
            assert name.replace("_", "-") in str(error).replace("_", "-"), error
    assert len(refused) < len(options) / 2 or method == "shortest", refused
