"""Presets: the parameters of a machine as a TOML file, checked, found by name, and written.

A file says what differs from Tables I and II in the tables `[robot]` (`RobotParams`), `[motor]`
(`MotorParams`), `[world]` (those of `World` that belong to a machine) and `[world.sensor]`. In
each, `source` says where its values are from: a text, or a table with a text for each of them; at
the top of the file it says so of the machine.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from cosim.base.errors import UserError
from cosim.base.reading import Kind, read_toml
from cosim.base.storage import replacing, require_suffix
from cosim.model.config import UNKNOWN, CoSimConfig
from cosim.model.params import (
    STEERING,
    TABLE_I,
    TABLE_II,
    MotorParams,
    RobotParams,
    SteeringParams,
    lift_off_speed,
)
from cosim.model.scenario import Scenario
from cosim.model.world import IDEAL, Sensor, World, parameter_name

PAPER = "paper"
# Fields of a world that a machine brings along; the others are of the table that it stands on.
WORLD_FIELDS = ("restitution", "motor_spread", "motor_speed_noise")
_SIZE = ("diameter_m", "foot_radius_m", "motor_radius_m")
_FOLDER = Path(__file__).parent


_FILE = Kind("preset file", "check the path")


class Preset(NamedTuple):
    """A machine.

    Attributes:
        name: what `--preset` calls it, or the file's name without its ending.
        source: of the machine, for people.
        robot: body, feet and friction.
        motor: nominal parameters of every motor.
        world: what the machine brings along of it: `WORLD_FIELDS` and the camera.
        sources: of parameters, by the names of `CoSimConfig.table`.
    """

    name: str = PAPER
    source: str = ""
    robot: RobotParams = TABLE_I
    motor: MotorParams = TABLE_II
    world: World = IDEAL
    sources: Mapping[str, str] = {}

    def config(self, world: World = IDEAL) -> CoSimConfig:
        """Parameters of a co-simulation of the machine in a world, not yet calibrated.

        Motor speeds of the steering are those of the paper's robot, as shares of lift-off. What the
        world states overrides what the machine brings along.
        """
        sources = {
            n: text
            for table in ("robot", "motor")
            for n, text in self.stated_sources(table).items()
        }
        machine = CoSimConfig(
            robot=self.robot,
            motor=self.motor,
            steering=_steering(0.0),
            preset=self.name,
            sources=tuple(sources.items()),
        )
        share = machine.lift_off_rad_s / lift_off_speed(TABLE_I, TABLE_II)
        config = replace(machine, steering=_steering(share)).in_world(self.in_world(world))
        brought = self.stated_sources("world") | self.stated_sources("world.sensor")
        return config.sourced({n: t for n, t in brought.items() if n not in world.stated})

    def stated_sources(self, table: str) -> dict[str, str]:
        """Return the source of every value of a table that the machine states, by parameter."""
        record, usual, names = _TABLES[table]
        own = {
            parameter_name(table, n): getattr(record(self), n) != getattr(usual, n) for n in names
        }
        known = {n: text for n, text in self.sources.items() if not text.startswith(UNKNOWN)}
        text = f"preset {self.name}"
        return {n: self.sources.get(n, text) for n, new in own.items() if new or n in known}

    def board(self, scenario: Scenario) -> Scenario:
        """Return a scenario with robots of the diameter that it states, by default the machine's.

        A machine that states nothing of its size, such as the paper's, has any diameter: feet and
        motors are scaled, see `CoSimConfig.sized`.
        """
        stated_m, own_m = scenario.robot_diameter_m, self.robot.diameter_m
        if stated_m is None and own_m != scenario.diameter_m:
            return replace(scenario, robot_diameter_m=own_m)
        size = [n for n in self.stated_sources("robot") if n in _SIZE]
        if scenario.diameter_m != own_m and size:
            raise UserError(
                f"preset {self.name} states {' and '.join(size)} of a machine of diameter_m = "
                f"{own_m:g}, but scenario {scenario.name} has robot_diameter_m = {stated_m:g}; "
                "leave it out of the scenario, or choose another machine"
            )
        return scenario

    def in_world(self, world: World) -> World:
        """A world with the machine's values; explicit values of the world override them."""
        brought = {
            name: getattr(self.world, name)
            for name in (*WORLD_FIELDS, "sensor")
            if getattr(world, name) is None
        }
        return msgspec.structs.replace(world, **brought)

    def save(self, path: str | Path) -> None:
        """Write a file that `find_preset` reads: what the machine states, with sources."""
        with replacing(require_suffix(path, ".toml")) as temporary:
            temporary.write_text("\n".join(self._lines()) + "\n", encoding="utf-8")

    def _lines(self) -> Iterator[str]:
        yield f"source = {_text(self.source)}"
        for table, (record, _, names) in _TABLES.items():
            mine, said = record(self), self.stated_sources(table)
            own = {n: said[name] for n in names if (name := parameter_name(table, n)) in said}
            if own:
                yield from ("", f"[{table}]")
                yield from (f"{name} = {float(getattr(mine, name))!r}" for name in own)
                yield from ("", f"[{table}.source]")
                yield from (f"{name} = {_text(text)}" for name, text in own.items())


_TABLES = {
    "robot": (lambda preset: preset.robot, TABLE_I, RobotParams._fields),
    "motor": (lambda preset: preset.motor, TABLE_II, MotorParams._fields),
    "world": (lambda preset: preset.world, IDEAL, WORLD_FIELDS),
    "world.sensor": (lambda preset: preset.world.camera, Sensor(), Sensor.__struct_fields__),
}


def built_in() -> list[str]:
    """Names of the built-in presets, the paper's first."""
    return sorted((path.stem for path in _FOLDER.glob("*.toml")), key=lambda n: (n != PAPER, n))


def find_preset(name_or_path: str | Path | Preset) -> Preset:
    """Built-in preset of that name, or the one in a TOML file.

    Args:
        name_or_path: `paper`, `icra2006`, `thesis`, or a file (.toml); a record is returned as it
            is.

    Raises:
        UserError: there is none, it is no TOML, or no such machine can be; the message names the
            field.
    """
    if isinstance(name_or_path, Preset):
        return name_or_path
    name = str(name_or_path)
    if name in built_in():
        path = _FOLDER / f"{name}.toml"
    elif name.endswith(".toml"):
        path = Path(name)
    else:
        raise UserError(
            f"unknown preset '{name}'; choose one of {', '.join(built_in())} or name a .toml file"
        )
    content = read_toml(path, _FILE)
    try:
        preset = _preset(path.stem, content)
        preset.config()
    except UserError as error:
        raise UserError(f"{path}: {error}") from None
    return preset


def _steering(share: float) -> SteeringParams:
    """The paper's steering with a share of its motor speeds."""
    speeds = [name for name in STEERING._fields if name.endswith("_speed_rad_s")]
    return STEERING._replace(**{name: share * getattr(STEERING, name) for name in speeds})


def _preset(name: str, file: dict[str, Any]) -> Preset:
    rest = dict(file)
    source = rest.pop("source", "")
    if not isinstance(source, str):
        raise UserError("source: give a text")
    tables = {table: _taken(rest, table) for table in ("robot", "motor", "world")}
    _refuse_unknown("", rest, ("source", "robot", "motor", "world"))
    tables["world.sensor"] = _taken(tables["world"], "sensor", "world.")
    values: dict[str, dict[str, float]] = {}
    sources: dict[str, str] = {}
    for table, content in tables.items():
        said = content.pop("source", {})
        _refuse_unknown(f"{table}.", content, _TABLES[table][2])
        texts = dict.fromkeys(content, said) if isinstance(said, str) else said
        if not isinstance(texts, dict) or not all(isinstance(t, str) for t in texts.values()):
            raise UserError(f"{table}.source: give a text, or a table with a text for each value")
        _refuse_unknown(f"{table}.source.", texts, tuple(content))
        values[table] = {field: _number(f"{table}.{field}", v) for field, v in content.items()}
        texts = dict.fromkeys(content, f"preset {name}") | texts
        sources |= {parameter_name(table, field): text for field, text in texts.items()}
    brought: dict[str, Any] = values["world"]
    return Preset(
        name,
        source,
        TABLE_I._replace(**values["robot"]),
        TABLE_II._replace(**values["motor"]),
        World(sensor=Sensor(**camera) if (camera := values["world.sensor"]) else None, **brought),
        sources,
    )


def _taken(content: dict[str, Any], table: str, where: str = "") -> dict[str, Any]:
    """A table that is taken out of another one."""
    taken = content.pop(table, {})
    if not isinstance(taken, dict):
        raise UserError(f"{where}{table}: give a table [{where}{table}]")
    return dict(taken)


def _refuse_unknown(where: str, content: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for name in content:
        if name not in known:
            raise UserError(
                f"{where}{name} is unknown to presets; choose from {', '.join(known) or 'nothing'}"
            )


def _number(field: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise UserError(f"{field} = {value!r} is not a number; give one")
    try:
        return float(value)
    except OverflowError:
        raise UserError(f"{field} is larger than any float; give a smaller number") from None


def _text(text: str) -> str:
    """A text as TOML has it, which is as JSON has it."""
    return json.dumps(text, ensure_ascii=False)
