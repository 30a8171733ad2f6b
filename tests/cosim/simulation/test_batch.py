"""Episodes that share a batch are, bit for bit, those that have a co-simulation to themselves."""

import math
import re
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from fmpy.fmi3 import FMU3Slave
from msgspec.structs import replace

from cosim import model
from cosim.base.arguments import ConfigError
from cosim.base.errors import UserError
from cosim.coupling.master import NotFiniteError
from cosim.coupling.rl_step import Step
from cosim.model.config import CoSimConfig
from cosim.model.params import STEERING, TABLE_I, TABLE_II, TIMING, MotorShares
from cosim.model.preset import find_preset
from cosim.model.scenario import Scenario
from cosim.model.scenario_file import find_scenario
from cosim.model.world import Patch, Sensor, World
from cosim.physics.body_state import Z
from cosim.physics.lanes import host_lanes
from cosim.recording.series import with_bursts
from cosim.simulation.batch import Batch, chosen_driver
from cosim.simulation.tasks import Task, simulate_tasks
from docs.examples.draw_machine import machine
from tests.alone import Constant, CoSimulation, same

EAST, NORTH, WEST, SOUTH = 0, 2, 4, 6
LARGE = Scenario("large", "", ((5, 20), (20, 20)), (((5, 5),), ((20, 5),)))
# a small board, and an obstacle on it
STARTS, TARGETS = (((4, 4),), ((14, 4),)), ((4, 16), (14, 16))
SMALL = Scenario("small", "", TARGETS, STARTS, 20, 20, zone=(0, 0, 0, 0), obstacles=((9, 6),))
ONE = Scenario("one", "", ((5, 5),), (((15, 15),),))


# scenario, starts, directions; within seconds the second one leaves the board, the third collides
EPISODES = [
    (LARGE, ((5, 5), (20, 5)), (NORTH, NORTH)),
    (SMALL, ((4, 0), (14, 4)), (SOUTH, NORTH)),
    (LARGE, ((5, 5), (5, 11)), (NORTH, SOUTH)),
    (SMALL, ((4, 4), (14, 10)), (NORTH, NORTH)),
]


def simulated(
    fmu: Path, *configs: CoSimConfig, number: int = 0, steps: int = 1, drop_m: float = 0, **options
) -> list[Step]:
    """RL steps of the last of some episodes that have a batch to themselves, one by one.

    Robots begin at a height of `drop_m` above the floor.
    """
    scenario, starts, directions = EPISODES[number]
    batch, found = Batch(fmu, configs[0], 2, 1, **options), []
    for config in configs:
        batch.begin(0, scenario, starts, np.random.SeedSequence(number), config)
        batch.state.bodies.motion[Z] += drop_m
        found = [batch.advance({0: np.array(directions)})[0] for _ in range(steps)]
    batch.close()
    return found


@pytest.mark.ci
@pytest.mark.parametrize(
    ("fmu", "coupling", "differ"),
    [
        ("motor_fmu", {}, False),
        *((f"{of}_fmu", {"reaction": r}, True) for of in ("motor", "array") for r in (False, True)),
    ],
)
def test_steps_do_not_depend_on_who_shares_the_batch(fmu, coupling, differ, request):
    path, config = request.getfixturevalue(fmu), with_bursts(CoSimConfig(**coupling), "default")
    batch = Batch(path, config, robots=2, places=3)
    own = config.in_world(World(motor_spread=0.1)) if differ else config
    configs = [own, own, own, config]

    def begin(place: int, number: int) -> None:
        seed = np.random.SeedSequence(number)
        batch.begin(place, *EPISODES[number][:2], seed, configs[number])

    held = {place: place for place in range(3)}
    found: dict[int, list] = {number: [] for number in range(4)}
    for place, number in held.items():
        begin(place, number)
    for _ in range(4):
        actions = {place: np.array(EPISODES[held[place]][2]) for place in batch.going_on()}
        for place, step in batch.advance(actions).items():
            found[held[place]].append(step)
            if step.outcome and 3 not in held.values():
                held[place] = 3
                begin(place, 3)
    owners = batch.state.floor.owners[:6]  # of targets in any order of an episode's robots
    assert np.array_equal(np.sort(owners.reshape(3, 2), axis=1), [[0, 1], [2, 3], [4, 5]])
    last = found[2][-1].samples.position[-1]
    assert np.array_equal(batch.state.bodies.motion[:3, 4:6].T, last)  # nothing moves after its end
    batch.close()
    outcomes = [found[number][-1].outcome for number in range(4)]
    assert outcomes == ["", "out_of_board", "collision", ""]
    assert len(found[3]) > 1  # begun where the second one ended
    for number, steps in found.items():
        expected = simulated(path, configs[number], number=number, steps=len(steps))
        for ours, theirs in zip(steps, expected, strict=True):
            assert same((*ours.samples, *ours.raw), (*theirs.samples, *theirs.raw))
            assert np.array_equal(ours.after.cells, theirs.after.cells)
            assert ours.outcome == theirs.outcome
            assert len(ours.raw.omega) > 0


def test_a_board_for_a_machine_that_turns_in_circles_has_the_cells_that_are_asked_for(array_fmu):
    config, board = CoSimConfig().having("test", turn_radius_m=0.012), find_scenario("1a")
    with pytest.raises(ConfigError, match=r"circles of radius 12 mm, .* mm wide") as refused:
        CoSimulation(board, array_fmu, config).reset()
    (wide,) = re.findall(r"make them (\d+) mm", str(refused.value))
    cell: dict[str, Any] = {"cell_m": 1e-3 * float(wide), "zone": (4, 4, 7, 7)}
    wider = Scenario("wide", "", ((5, 5),), (((5, 9),),), 12, 12, **cell)
    CoSimulation(wider, array_fmu, config).reset()


@pytest.mark.parametrize(
    "kind",
    [
        *(pytest.param(kind, marks=pytest.mark.long) for kind in ("rigid", "reaction")),
        pytest.param("legs", marks=pytest.mark.ci),
    ],
)
def test_drivers_give_another_machine_the_same_bits(kind, array_fmu, tmp_path):
    """Motors of which one has its own r, on feet of which one has its own mu.

    Three on four feet or two on three legs, in the lanes of other tests: these are compiled anyway.
    """
    file, reaction, lanes = tmp_path / "drawn.toml", kind == "reaction", host_lanes()
    parts, drivers = machine(1).split("\n\n"), ["compiled", "fmpy"][: 2 - reaction]
    text = "\n\n".join(parts[:1] + parts[2:])  # without its first motor
    if kind == "legs":
        lanes, text = 2, Path(model.__file__).with_name("pogobot-brush.toml").read_text("utf-8")
        text = text.replace("r = 0.001\n", "", 1).replace("0.053", "0.05")
    file.write_text(text.replace("axis", "r = 0.0018\naxis", 1) + "\nmu = 0.2", "utf-8")
    preset = find_preset(file)
    shares = tuple(MotorShares(s, -s, 0.3, 0.2, 1.0, -1.0, s) for s in (-1.0, 1.0, 0.5))
    shares = shares[: len(preset.config().robot.motors)]
    speeds = {n: 780.0 for n in STEERING._fields if n.endswith("_speed_rad_s")}
    speeds |= {"drive_speed_m_s": 0.004, "turn_rate_rad_s": 0.2}
    own = {"reaction": reaction, "shares": shares, "rl_step_s": 0.1, "burst_s": 0.1, **speeds}
    config = preset.config().having("test", **own)
    step, *others = (
        simulated(array_fmu, config, driver=driver, drop_m=1e-3, **how)[0]
        for driver, how in (*((d, {"lanes": lanes}) for d in drivers), ("reference", {}))
    )
    first = step.samples
    assert np.ptp(first.position[:, 0], axis=0)[:2].max() > 1e-5
    assert all(same(first, other.samples) for other in others)
    # What is said of a control period is that of its ticks: feet land one after the other.
    normal = step.raw.normal.reshape(len(first.position), -1, *step.raw.normal.shape[1:])
    without = normal <= 0.0
    several = without.sum(axis=-1)
    assert {*several.flat} == {*range(normal.shape[-1] + 1)}
    np.testing.assert_allclose(first.normal_mean, normal.mean(axis=1), rtol=1e-9)
    np.testing.assert_array_equal(first.lifted_share, without.any(axis=-1).mean(axis=1))
    np.testing.assert_array_equal(first.airborne_share, without.all(axis=-1).mean(axis=1))


@pytest.mark.long
def test_results_do_not_depend_on_threads_or_places(array_fmu):
    timing = CoSimConfig().timing._replace(episode_limit_s=6.0)
    config = CoSimConfig(timing=timing)
    tasks = [
        Task(scenario, array_fmu, config, Constant(*way), starts, np.random.SeedSequence(number))
        for number, (scenario, starts, way) in enumerate(EPISODES)
    ]

    def results(some, threads):
        found = dict(simulate_tasks(some, threads))
        return [found[k] for k in sorted(found)]

    together, in_threads = results(tasks, 1), results(tasks, 2)
    one_by_one = [results([task], 1)[0] for task in tasks]
    for others in (in_threads, one_by_one):
        assert [replace(r, realtime_factor=0.0) for r in others] == [
            replace(r, realtime_factor=0.0) for r in together
        ]
    assert {r.outcome for r in together} == {"out_of_board", "collision", "timeout"}


WORLDS = [
    {"mu": 0.3, "restitution": 0.3},
    {"floor_tilt_deg": 2.0, "mu_patches": (Patch((0, 0, 29, 8), 0.4), Patch((2, 6, 6, 9), 0.05))},
    {"payload_g": 20.0, "payload_offset_mm": (4.0, -3.0), "motor_spread": 0.05},
    {"motor_speed_noise": 0.1, "sensor": Sensor(30.0, 20.0, 0.5, 1.0)},
    {"sensor": Sensor(100.0, 60.0, 1.0, 1.0, 0.2)},
]


@pytest.mark.long
@pytest.mark.parametrize(("driver", "step_s"), [("compiled", 0.2), ("reference", 0.02)])
def test_worlds_share_a_batch_and_keep_their_bits(driver, step_s, array_fmu):
    """Each episode is that of a batch of its own, whatever the number of lanes."""
    scenario, starts, way = EPISODES[0]
    nominal = CoSimConfig(timing=TIMING._replace(rl_step_s=step_s))
    configs = [nominal.in_world(World(**world)) for world in WORLDS]

    def simulate(numbers, **options):
        batch = Batch(array_fmu, nominal, 2, len(numbers), **options)
        for place, number in enumerate(numbers):
            seed = np.random.SeedSequence(number)
            batch.begin(place, scenario, starts, seed, configs[number])
        actions = dict.fromkeys(range(len(numbers)), np.array(way))
        batch.advance(actions)
        steps = batch.advance(actions)
        batch.close()
        return [step.samples for step in steps.values()]

    together = simulate(range(len(WORLDS)), lanes=host_lanes())
    assert len({samples.position[-1].tobytes() for samples in together}) == len(WORLDS)
    options = {"lanes": 2} if driver == "compiled" else {"driver": driver}
    for number, samples in enumerate(together):
        assert same(samples, simulate([number], **options)[0])


def test_motors_begin_at_the_phases_of_their_world(motor_fmu, array_fmu):
    """To the same bits in all drivers, and no phase is left to the next episode of a place."""
    phases_deg = (90.0, -45.0, 10.0, 180.0)
    timing = TIMING._replace(rl_step_s=0.01, communication_step_s=2e-5, burst_s=1e-4)
    usual = CoSimConfig(timing=timing)
    turned = usual.in_world(World(motor_phases_deg=phases_deg))
    for fmu in (motor_fmu, array_fmu):
        (step,) = simulated(fmu, turned)
        first_rad = step.raw.theta[0].reshape(-1)
        np.testing.assert_allclose(first_rad, np.radians(phases_deg), atol=1e-3)
        others = [{"lanes": host_lanes()}, {"driver": "reference"}]
        others += [{"driver": "fmpy"}] if fmu == array_fmu else []
        for options in others:
            assert same(step.samples, simulated(fmu, turned, **options)[0].samples)
        after, alone = simulated(fmu, turned, usual)[0], simulated(fmu, usual)[0]
        assert same(after.samples, alone.samples)


@pytest.mark.parametrize("mu", [0.1, 0.2])
def test_a_still_robot_slides_down_a_floor_steeper_than_its_friction(mu, array_fmu):
    """In the direction that the episode has drawn, as Galileo says."""
    robot = TABLE_I._replace(mu=mu)
    motor = TABLE_II._replace(m=1e-12)  # only the torque of its start is felt
    timing = TIMING._replace(rl_step_s=0.2)
    world, slope = World(floor_tilt_deg=8.0), math.radians(8.0)
    config = CoSimConfig(robot=robot, motor=motor, timing=timing, world=world)
    batch = Batch(array_fmu, config, 1, 1)
    episode = batch.begin(0, ONE, ((15, 15),), np.random.SeedSequence(3))
    (step,) = batch.advance({0: np.array([NORTH])}).values()
    batch.close()
    velocity = step.samples.velocity[:, 0]
    rate = (velocity[-1] - velocity[0]) / (1e-3 * (len(velocity) - 1))
    towards = math.radians(episode.drawn.tilt_direction_deg)
    down = max(0.0, TABLE_II.g * (math.sin(slope) - mu * math.cos(slope)))
    expected = [down * math.cos(towards), down * math.sin(towards), 0.0]
    np.testing.assert_allclose(rate, expected, rtol=5e-4, atol=1e-6)


@pytest.mark.parametrize("changes", [{}, {"dt_s": 5e-6, "communication_step_s": 5e-6},
    {"communication_step_s": 5e-5}], ids=["default", "dt", "step"])  # fmt: skip
def test_fmpy_steps_once_per_control_period_and_instance(array_fmu, monkeypatch, changes):
    """1000 calls per simulated second for all motors of a batch, with the bits of other drivers."""
    do_step, calls = FMU3Slave.doStep, []

    def counted(slave, *arguments):
        calls.append((slave.instanceName, arguments))
        return do_step(slave, *arguments)

    monkeypatch.setattr(FMU3Slave, "doStep", counted)
    config = CoSimConfig(timing=TIMING._replace(rl_step_s=0.2, **changes))
    signals = []
    for driver in ("fmpy", "compiled"):
        batch = Batch(array_fmu, config, 2, 2, driver)
        for place in range(2):
            batch.begin(place, *EPISODES[0][:2], np.random.SeedSequence(place))
        steps = batch.advance(dict.fromkeys(range(2), np.array([NORTH, NORTH])))
        signals.append([signal for step in steps.values() for signal in step.samples])
        batch.close()
    assert len(calls) == 200  # none of them by the compiled driver
    assert {name for name, _ in calls} == {"motors"}
    assert [time_s for _, (time_s, _) in calls] == pytest.approx(1e-3 * np.arange(200))
    assert [step_s for _, (_, step_s) in calls] == pytest.approx(np.full(200, 1e-3))
    assert all(map(np.array_equal, *signals))


@pytest.mark.long
def test_force_statistics_do_not_depend_on_dt(array_fmu):
    """Within 5 %, of eight pairs that drive for 8 s: friction depends on how their masses drift."""
    found = []
    for dt_s in (1e-5, 5e-6):
        timing = TIMING._replace(dt_s=dt_s, communication_step_s=dt_s)
        batch = Batch(array_fmu, CoSimConfig(timing=timing), 2, 8)
        for place in range(8):
            batch.begin(place, *EPISODES[0][:2], np.random.SeedSequence(place))
        actions = dict.fromkeys(range(8), np.array([NORTH, NORTH]))
        steps = [step.samples for _ in range(4) for step in batch.advance(actions).values()]
        batch.close()
        normal, friction, impact = (
            np.concatenate([getattr(step, name) for step in steps])
            for name in ("normal_mean", "friction_mean", "impact")
        )
        spread = (normal.std(), *np.quantile(normal, [0.95, 0.99]), np.quantile(impact, 0.99))
        found.append([normal.mean(), friction.mean(), impact.sum(), *spread])
    assert found[0] == pytest.approx(found[1], rel=0.05)


def test_fmpy_is_refused_where_it_cannot_step(motor_fmu, array_fmu):
    refused = "driver fmpy cannot be used: .*%s.*; use --driver compiled"
    for fmu, changes, reason in (
        (array_fmu, {"reaction": True}, "with --reaction"),
        (motor_fmu, {}, "VibrationMotor.fmu has no theta_samples"),
        (array_fmu, {"timing": TIMING._replace(dt_s=2.5e-5, communication_step_s=2.5e-5)},
         "2.5e-05 s is not a multiple of step_size = 1e-05"),
    ):  # fmt: skip
        config = CoSimConfig(**cast(Any, changes))
        with pytest.raises(ConfigError, match=refused % re.escape(reason)):
            Batch(fmu, config, 1, 1, "fmpy")
        assert chosen_driver(None, fmu, config) == "compiled"
    assert chosen_driver(None, array_fmu, CoSimConfig()) == "fmpy"
    assert chosen_driver("compiled", array_fmu, CoSimConfig()) == "compiled"


@pytest.mark.parametrize("lane", [2, 3])
def test_an_error_of_an_idle_lane_says_whose_it_is(lane, array_fmu):
    """One of a place without an episode, and one that only fills the vector."""
    batch = Batch(array_fmu, CoSimConfig(), 1, 3)
    batch.begin(0, ONE, ((15, 15),), np.random.SeedSequence(3))
    batch.state.bodies.motion[0, lane] = np.nan
    with pytest.raises(NotFiniteError, match=r"robot 1 .* nan at"):
        batch.advance({0: np.array([NORTH])})
    batch.close()


def test_errors_of_a_thread_are_raised_where_results_are_taken(array_fmu):
    class Broken:
        def act(self, observation):
            raise ValueError("no action")

    scenario, starts, _ = EPISODES[0]
    task = Task(scenario, array_fmu, CoSimConfig(), Broken(), starts, np.random.SeedSequence(0))
    with pytest.raises(ValueError, match="no action"):
        list(simulate_tasks([task] * 3, 2))


def test_what_does_not_fit_a_batch_is_refused(array_fmu):
    with pytest.raises(ConfigError, match=r"lanes = 2 .*driver reference"):
        Batch(array_fmu, CoSimConfig(), 2, 1, "reference", lanes=2)
    batch, seed = Batch(array_fmu, CoSimConfig(), 1, 2), np.random.SeedSequence(0)
    with pytest.raises(ConfigError, match=r"scenario large has 2 robots.* 1"):
        batch.begin(0, LARGE, ((5, 5), (20, 5)), seed)
    with pytest.raises(UserError, match=r"4 angles.* 2 motors"):
        turned = CoSimConfig(world=World(motor_phases_deg=(0.0,) * 4))
        batch.begin(0, ONE, ((15, 15),), seed, turned)
    with pytest.raises(ConfigError, match="by more than its world"):
        batch.begin(0, LARGE, ((5, 5), (20, 5)), seed, CoSimConfig(reaction=True))
