"""Presets: the parameters of a machine as a TOML file, checked, found by name, and written.

A file says what differs from Tables I and II in the tables `[robot]` (`RobotParams`), `[motor]`
(`MotorParams`), `[world]` (those of `World` that belong to a machine) and `[world.sensor]`. In
each, `source` says where its values are from: a text, or a table with a text for each of them; at
the top of the file it says so of the machine.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import msgspec

from cosim.base.arguments import require_names, validate_argument
from cosim.base.errors import UserError
from cosim.base.reading import Kind, naming, read_toml
from cosim.base.storage import replacing, require_suffix
from cosim.model.config import CoSimConfig, proportional
from cosim.model.params import (
    STEERING,
    TABLE_I,
    TABLE_II,
    MotorParams,
    RobotParams,
    lift_off_speed,
)
from cosim.model.scenario import Scenario
from cosim.model.world import Sensor, parameter_name

PAPER = "paper"
# What a machine may state. Other fields of a world are of the table that the machine stands on.
FIELDS = {
    "robot": RobotParams._fields,
    "motor": MotorParams._fields,
    "world": ("restitution", "motor_spread", "motor_speed_noise"),
    "world.sensor": Sensor.__struct_fields__,
}
_SIZE = ("diameter_m", "foot_radius_m", "motor_radius_m")
_FOLDER = Path(__file__).parent
_FILE = Kind("preset file", "check the path")


class Preset(NamedTuple):
    """A machine.

    Attributes:
        name: what `--preset` calls it, or the file's name without its ending.
        source: of the machine, for people.
        tree: what the machine states, by the names of `CoSimConfig.table`.
    """

    name: str = PAPER
    source: str = ""
    tree: Mapping[str, tuple[Any, str]] = {}

    def config(self, *trees: Mapping[str, tuple[Any, str]]) -> CoSimConfig:
        """Parameters of the machine, over which later trees hold first; not yet calibrated.

        Motor speeds of the steering are those of the paper's robot, as shares of lift-off.
        """
        tree = {name: leaf for each in (self.tree, *trees) for name, leaf in each.items()}
        robot, motor = (
            validate_argument(
                name, [tree.get(n, (v,))[0] for n, v in usual._asdict().items()], type(usual)
            )
            for name, usual in (("robot", TABLE_I), ("motor", TABLE_II))
        )
        share = lift_off_speed(robot, motor) / lift_off_speed(TABLE_I, TABLE_II)
        steering = {} if share == 1.0 else proportional(STEERING, share)
        return CoSimConfig(preset=self.name).merged(steering, tree)

    def board(self, scenario: Scenario) -> Scenario:
        """Return a scenario with robots of the diameter that it states, by default the machine's.

        A machine that states nothing of its size, such as the paper's, has any diameter: feet and
        motors are scaled, see `CoSimConfig.sized`.
        """
        stated_m = scenario.robot_diameter_m
        own_m, _ = self.tree.get("diameter_m", (TABLE_I.diameter_m, ""))
        if stated_m is None and own_m != scenario.diameter_m:
            return replace(scenario, robot_diameter_m=own_m)
        size = [n for n in self.tree if n in _SIZE]
        if scenario.diameter_m != own_m and size:
            raise UserError(
                f"preset {self.name} states {' and '.join(size)} of a machine of diameter_m = "
                f"{own_m:g}, but scenario {scenario.name} has robot_diameter_m = {stated_m:g}; "
                "leave it out of the scenario, or choose another machine"
            )
        return scenario

    def save(self, path: str | Path) -> None:
        """Write a file that `find_preset` reads: what the machine states, with sources."""
        lines = [f"source = {_text(self.source)}"]
        for table, fields in FIELDS.items():
            names = {field: parameter_name(table, field) for field in fields}
            own = {field: self.tree[name] for field, name in names.items() if name in self.tree}
            if own:
                lines += ["", f"[{table}]", *(f"{n} = {float(v)!r}" for n, (v, _) in own.items())]
                texts = (f"{name} = {_text(text)}" for name, (_, text) in own.items())
                lines += ["", f"[{table}.source]", *texts]
        with replacing(require_suffix(path, ".toml")) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")


def built_in() -> list[str]:
    """Names of the built-in presets, the paper's first."""
    return sorted((path.stem for path in _FOLDER.glob("*.toml")), key=lambda n: (n != PAPER, n))


def find_preset(name_or_path: str | Path | Preset) -> Preset:
    """Built-in preset of that name, or the one in a TOML file; a record is returned as it is."""
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
    with naming(path):
        preset = _preset(path.stem, content)
        preset.config()  # which validates it
    return preset


class _File(msgspec.Struct, forbid_unknown_fields=True):
    source: str = ""
    robot: dict[str, Any] = {}
    motor: dict[str, Any] = {}
    world: dict[str, Any] = {}


def _preset(name: str, content: dict[str, Any]) -> Preset:
    file = validate_argument("", content, _File)
    tables = {"robot": file.robot, "motor": file.motor, "world": file.world}
    tables["world.sensor"] = validate_argument(
        "world.sensor", file.world.pop("sensor", {}), dict[str, Any]
    )
    tree: dict[str, tuple[Any, str]] = {}
    for table, values in tables.items():
        texts = validate_argument(f"{table}.source", values.pop("source", {}), str | dict[str, str])
        texts = dict.fromkeys(values, texts) if isinstance(texts, str) else texts
        require_names(f"{table}.", values, FIELDS[table])
        require_names(f"{table}.source.", texts, list(values))
        tree |= {
            parameter_name(table, field): (value, texts.get(field, f"preset {name}"))
            for field, value in values.items()
        }
    return Preset(name, file.source, tree)


def _text(text: str) -> str:
    """A text as TOML has it, which is as JSON has it."""
    return json.dumps(text, ensure_ascii=False)
