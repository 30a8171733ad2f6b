"""Presets: machines as TOML files, checked, found by name, and written.

A file says what differs from Tables I and II: in `[body]` (`RobotParams`), `[motor]`
(`MotorParams`, of all motors), `[drive]` (of the steering), `[world]` (those of `World` that belong
to a machine) and `[world.sensor]`. Tables `[[motor]]` and `[[foot]]` say where motors and feet are,
and `shares` in each `[[motor]]` what it does in the motion primitives; where motors state none, a
calibration finds them. A `[[foot]]` with a length is an elastic leg. In each table, `source` says
where its values are from: a text, or a table with a text for each of them; at the top of the file
it says so of the machine.
"""

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta

from cosim.base.arguments import require_names, validate_argument
from cosim.base.errors import UserError
from cosim.base.reading import Kind, naming, read_toml
from cosim.base.storage import replacing, require_suffix
from cosim.model.config import CoSimConfig, not_calibrated, proportional
from cosim.model.params import (
    MAX_FEET,
    MAX_MOTORS,
    MAX_VALUE,
    STEERING,
    TABLE_I,
    TABLE_II,
    Amount,
    Drive,
    Foot,
    Lean,
    Leg,
    MotorParams,
    MotorShares,
    Mount,
    Positive,
    RobotParams,
    Turn,
    lift_off_speed,
)
from cosim.model.scenario import Scenario
from cosim.model.world import Sensor, Tree, parameter_name, tree_of

PAPER = "paper"
# What a machine may state. Other fields of a world are of the table that the machine stands on.
FIELDS = {
    "body": tuple(name for name in RobotParams._fields if name not in ("motors", "feet")),
    "motor": MotorParams._fields,
    "drive": ("drive_speed_m_s", "turn_rate_rad_s", "pulse_s", "pause_s"),
    "world": ("restitution", "motor_spread", "motor_speed_noise"),
    "world.sensor": Sensor.__struct_fields__,
}
_TABLES = ("motors", "shares", "feet")  # of `[[motor]]` and `[[foot]]`
_WEIGHED = tree_of("as weighed", masses_included=True)  # unless a file says otherwise
OF_LOOP = "K_p", "K_i", "relative_amplitude"  # what has an effect in the speed loop alone
# Names of parameters that files and options have others for
SHOWN = {"relative_amplitude": "motor_speed_noise (--noise)"}
PLANE_M = 1e-6  # heights of feet that differ by less are one: see docs/physics.md
_USUAL = TABLE_II._asdict()
_FOLDER = Path(__file__).parent
_FILE = Kind("preset file", "check the path")


class Preset(NamedTuple):
    """A machine.

    Attributes:
        name: what `--preset` calls it, or the file's name without its ending.
        tree: what the machine states, by the names of `CoSimConfig.table`.
    """

    name: str = PAPER
    source: str = ""
    tree: Mapping[str, tuple[Any, str]] = {}

    def config(self, *trees: Mapping[str, tuple[Any, str]]) -> CoSimConfig:
        """Parameters of the machine, over which later trees hold first; not yet calibrated.

        Motor speeds of the steering are those of the paper's robot, as shares of lift-off. A
        machine with motors or feet in other places has none before its calibration, unless its
        motors state their shares.
        """
        tree = {name: leaf for each in (_WEIGHED, self.tree, *trees) for name, leaf in each.items()}
        self._require_effect(tree)
        robot, motor = (
            validate_argument(
                name, [tree.get(n, (v,))[0] for n, v in usual._asdict().items()], type(usual)
            )
            for name, usual in (("robot", TABLE_I), ("motor", TABLE_II))
        )
        share = lift_off_speed(robot, motor) / lift_off_speed(TABLE_I, TABLE_II)
        steering = {} if share == 1.0 else proportional(STEERING, share)
        if "shares" in tree:
            shares, source = tree["shares"]
            drive = Drive(difference=tuple(own.left_turn for own in shares))
            steering |= tree_of(source, drives=(drive,) * 4)
        elif not tree.keys().isdisjoint({"motors", "feet"}):
            steering = not_calibrated(len(robot.motors))
        return CoSimConfig(preset=self.name).merged(steering, tree)

    def _require_effect(self, tree: Mapping[str, tuple[Any, str]]) -> None:
        """Refuse values that others make void."""
        mounts, _ = tree.get("motors", ((), ""))
        own = [dict(mount.own) for mount in mounts]
        stated = {*tree}.union(*own)
        for field in OF_LOOP if tree.get("pulse_s", (0.0,))[0] else ():
            if field in stated:
                raise UserError(
                    f"{SHOWN.get(field, field)} has no effect where motors are pulsed, which have "
                    "no speed loop; leave it out"
                )
        for name, (value, _) in tree.items():
            theirs = [each[name] for each in own if name in each]
            if len(theirs) == len(own) and any(each != value for each in theirs):
                raise UserError(
                    f"{name} = {value} has no effect: every motor of preset {self.name} states its "
                    "own; leave it out, or take it out of the tables [[motor]]"
                )

    def board(self, scenario: Scenario) -> Scenario:
        """Return a scenario with robots of the diameter that it states, by default the machine's.

        A machine that does not state its own, such as the paper's, has any: its feet and motors are
        spread in proportion, see `CoSimConfig.sized`.
        """
        stated_m = scenario.robot_diameter_m
        own_m, _ = self.tree.get("diameter_m", (TABLE_I.diameter_m, ""))
        if stated_m is None and own_m != scenario.diameter_m:
            return replace(scenario, robot_diameter_m=own_m)
        if scenario.diameter_m != own_m and "diameter_m" in self.tree:
            raise UserError(
                f"preset {self.name} states diameter_m = {own_m:g}, but scenario {scenario.name} "
                f"has robot_diameter_m = {stated_m:g}; leave it out of the scenario, or choose "
                "another machine"
            )
        return scenario

    def save(self, path: str | Path) -> None:
        """Write a file that `find_preset` reads: what the machine states, with sources."""
        lines = [f"source = {_value(self.source)}"]
        own = {name: leaf for name, leaf in self.tree.items() if name not in _TABLES}
        for table, fields in FIELDS.items():
            names = {field: parameter_name(table, field) for field in fields}
            stated = {field: own[name] for field, name in names.items() if name in own}
            if stated and not (table == "motor" and "motors" in self.tree):
                lines += _table(f"[{table}]", {n: value for n, (value, _) in stated.items()})
                lines += _table(f"[{table}.source]", {n: text for n, (_, text) in stated.items()})
        mounts, source = self.tree.get("motors", ((), ""))
        common = {n: v for n, (v, _) in own.items() if n in FIELDS["motor"]}
        notes = [
            f"{n} {text}" for n, (_, text) in own.items() if n in common and text not in source
        ]
        source = "; ".join([source, *notes])
        shares, _ = self.tree.get("shares", (len(mounts) * [MotorShares()], ""))
        for mount, share in zip(mounts, shares, strict=True):
            where = {"source": source, "place_m": mount.place_m, "axis": mount.axis}
            given = {"shares": share._asdict()} if any(share) else {}
            lines += _table("[[motor]]", where | given | common | dict(mount.own))
        feet, source = self.tree.get("feet", ((), ""))
        for foot in feet:
            own = {} if foot.mu is None else {"mu": foot.mu}
            own |= foot.leg._asdict() if foot.leg else {}
            if not own.get("lean_deg", 1.0):
                del own["lean_deg"], own["lean_towards_deg"]
            lines += _table("[[foot]]", {"source": source, "place_m": (foot.x_m, foot.y_m)} | own)
        with replacing(require_suffix(path, ".toml")) as temporary:
            temporary.write_text("\n".join(lines) + "\n", encoding="utf-8", errors="replace")


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


_Component = dict[str, Any]
_Near = Annotated[float, Meta(ge=-10.0, le=10.0)]  # in m: larger numbers have another unit


class _File(msgspec.Struct, forbid_unknown_fields=True):
    source: str = ""
    body: _Component = {}
    motor: _Component | Annotated[list[_Component], Meta(min_length=1, max_length=MAX_MOTORS)] = {}
    foot: Annotated[list[_Component], Meta(min_length=1, max_length=MAX_FEET)] | None = None
    drive: _Component = {}
    world: _Component = {}


class _Motor(msgspec.Struct, forbid_unknown_fields=True):
    place_m: tuple[_Near, _Near, _Near]
    axis: tuple[_Near, _Near, _Near]


_Length = Annotated[float, Meta(ge=1e-6, le=10.0)]
_Stiffness = Annotated[float, Meta(ge=1e-3, le=MAX_VALUE)]


class _Foot(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    place_m: Annotated[list[_Near], Meta(min_length=2, max_length=3)]
    mu: Amount | None = None


class _Leg(_Foot, kw_only=True):
    """An elastic leg."""

    length_m: _Length
    lean_deg: Lean = 0.0
    lean_towards_deg: Turn | None = None
    relaxation_s: Positive | None = None
    damping_ratio: Positive | None = None


class _Springs(_Leg, kw_only=True):
    axial_n_m: _Stiffness
    bending_n_m: _Stiffness


class _Beams(_Leg, kw_only=True):
    """Round cantilevers, side by side."""

    diameter_m: _Length
    young_pa: Annotated[float, Meta(ge=1e3, le=1e13)]
    count: Annotated[int, Meta(ge=1, le=100_000)] = 1

    @property
    def axial_n_m(self) -> float:
        """E A/L."""
        return self.count * self.young_pa * (0.25 * math.pi * self.diameter_m**2) / self.length_m

    @property
    def bending_n_m(self) -> float:
        """3 E I/L³ with I = A d²/16."""
        return self.axial_n_m * 3.0 / 16.0 * (self.diameter_m / self.length_m) ** 2


def _preset(name: str, content: dict[str, Any]) -> Preset:
    file = validate_argument("", content, _File)
    tables = {"body": file.body, "drive": file.drive, "world": file.world}
    tree: Tree = {}
    if isinstance(file.motor, list):
        tables["motor"], own = _motors(file.motor)
        tree |= own
    else:
        tables["motor"] = file.motor
    if file.foot is not None:
        body = validate_argument("body", file.body, dict[str, Any])
        mass_kg = body.get("mass_kg", TABLE_I.mass_kg)
        tree["feet"] = _feet(file.foot, validate_argument("body.mass_kg", mass_kg, Positive))
    tables["world.sensor"] = validate_argument(
        "world.sensor", file.world.pop("sensor", {}), dict[str, Any]
    )
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


def _motors(tables: list[_Component]) -> tuple[_Component, Tree]:
    """Return parameters that all motors state alike, and where each is and what it states."""
    source = _joined([str(table.pop("source", "")) for table in tables])
    found, falls, states_g = list[Mount](), set[float](), any("g" in table for table in tables)
    shares = _shares(tables)
    for k, table in enumerate(tables):
        where = f"motor[{k}]."
        require_names(where, table, ("place_m", "axis", *MotorParams._fields))
        stated = [name for name in MotorParams._fields if name in table]
        own = [table.pop(name, usual) for name, usual in _USUAL.items()]
        values = validate_argument(f"motor[{k}]", own, MotorParams)._asdict()
        place = validate_argument(f"motor[{k}]", table, _Motor)
        length = math.hypot(*place.axis)
        if length < 1e-6:
            raise UserError(f"{where}axis = {list(place.axis)} has no length; give a direction")
        length = 1.0 if abs(length - 1.0) < 1e-12 else length  # a file of ours keeps its bits
        x, y, z = (value / length for value in place.axis)
        falls.add(values["g"])
        own = tuple((name, values[name]) for name in stated if name != "g")
        found.append(Mount(place.place_m, (x, y, z), own))
    if len(falls) > 1:
        raise UserError(
            f"motors have g = {' and '.join(f'{g:g}' for g in sorted(falls))}; gravity is one: "
            "state the same in every table [[motor]], or none"
        )
    common = {n: v for n, v in found[0].own if all(dict(m.own).get(n) == v for m in found)}
    if states_g:
        common["g"] = falls.pop()
    return common | {"source": source}, tree_of(source, motors=tuple(found), shares=shares)


def _shares(tables: list[_Component]) -> tuple[MotorShares, ...] | None:
    """Take the shares of all motors out of their tables; None where they state none."""
    stated = [table.pop("shares", None) for table in tables]
    if all(own is None for own in stated):
        return None
    found = []
    for k, own in enumerate(stated):
        if own is None:
            raise UserError(
                f"motor[{k}] states no shares, but others do; give them in every table [[motor]], "
                "or in none, so that `minirobots calibrate` finds them"
            )
        table = validate_argument(f"motor[{k}].shares", own, dict[str, Any])
        require_names(f"motor[{k}].shares.", table, MotorShares._fields)
        values = [table.get(name, 0.0) for name in MotorShares._fields]
        found.append(validate_argument(f"motor[{k}].shares", values, MotorShares))
    return tuple(found)


def _feet(tables: list[_Component], mass_kg: float) -> tuple[Any, str]:
    sources = [str(table.pop("source", "")) for table in tables]
    feet = [validate_argument(f"foot[{k}]", t, _kind_of_foot(t)) for k, t in enumerate(tables)]
    heights = [foot.place_m[2] if len(foot.place_m) == 3 else 0.0 for foot in feet]
    if max(heights) - min(heights) > PLANE_M or abs(heights[0]) > PLANE_M:
        raise UserError(
            f"feet stand {1e6 * min(heights):g} to {1e6 * max(heights):g} µm above the floor; all "
            f"must be at 0, within {1e6 * PLANE_M:g} µm: a foot that is shorter carries nothing"
        )
    legs = {
        k: _leg(f"foot[{k}]", foot)
        for k, foot in enumerate(feet)
        if isinstance(foot, _Springs | _Beams)
    }
    bounce = math.sqrt(sum(leg.upright_n_m for leg in legs.values()) / mass_kg)
    for k, leg in legs.items():
        if feet[k].damping_ratio is not None:
            legs[k] = leg._replace(relaxation_s=2.0 * feet[k].damping_ratio / bounce)
    return tuple(
        Foot(foot.place_m[0], foot.place_m[1], foot.mu, legs.get(k)) for k, foot in enumerate(feet)
    ), _joined(sources)


def _kind_of_foot(table: _Component) -> type[_Foot]:
    """Return what a table describes, by what it states; a wrong name in it is refused later."""
    if table.keys() <= {*_Foot.__struct_fields__}:
        return _Foot
    beam = {*_Beams.__struct_fields__}.difference(_Leg.__struct_fields__)
    return _Springs if table.keys().isdisjoint(beam) else _Beams


def _leg(where: str, foot: _Springs | _Beams) -> Leg:
    """Return a leg, not yet with what follows from `damping_ratio`."""
    lean, towards = foot.lean_deg, foot.lean_towards_deg
    if (towards is None) != (lean == 0.0):
        raise UserError(
            f"{where}.lean_deg = {lean:g} and lean_towards_deg belong together; give both of a "
            "leg that leans, the direction on the floor from its root to its tip"
        )
    if (foot.relaxation_s is None) == (foot.damping_ratio is None):
        raise UserError(
            f"{where} needs relaxation_s or damping_ratio, and one of them: without damping a "
            "robot hops for ever"
        )
    relaxation_s = foot.relaxation_s or 0.0
    return Leg(lean, towards or 0.0, foot.axial_n_m, foot.bending_n_m, relaxation_s, foot.length_m)


def _joined(sources: list[str]) -> str:
    return "; ".join(dict.fromkeys(filter(None, sources))) or "the machine's file"


def _table(heading: str, values: Mapping[str, Any]) -> list[str]:
    """Lines of a table as TOML has it."""
    return ["", heading, *(f"{name} = {_value(value)}" for name, value in values.items())]


def _value(value: Any) -> str:
    """A text, number, truth value, list or table as in TOML; texts as in JSON, but for DEL."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name} = {_value(own)}' for name, own in value.items())}}}"
    return repr(value).lower() if isinstance(value, bool) else repr(float(value))
