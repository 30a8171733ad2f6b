"""Machines that hypothesis draws, built as users build them: as text that the file reader gets.

A `Machine` is the content of a file. Its methods return the same machine scaled, mirrored, turned
or in another order, as files of their own, so that laws of mechanics are oracles for all of them.
`machines` draws those that are valid, `broken` the nearest ones that are not.
"""

import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hypothesis import strategies as st

from cosim.model.config import CoSimConfig
from cosim.model.params import TABLE_II
from cosim.model.preset import Preset, find_preset

Table = dict[str, Any]
MASSES_KG = 0.005, 5.0
MOTORS, FEET = (1, 8), (3, 8)
TURN = 2.0 * math.pi


_LEG = {"length_m": 0.01, "axial_n_m": 1e6, "bending_n_m": 1e5, "relaxation_s": 1e-4}
# Tables of a foot's leg that are refused, and a word that the refusal must have
BROKEN_LEGS: list[tuple[Table, str]] = [
    (_LEG, "rigid"),  # one foot of several
    (_LEG | {"lean_deg": 61.0, "lean_towards_deg": 0.0}, "lean_deg"),
    (_LEG | {"bending_n_m": 0.0}, "bending_n_m"),
    (_LEG | {"relaxation_s": 0.0}, "relaxation_s"),
    (_LEG | {"damping_ratio": 0.1}, "damping_ratio"),
    (_LEG | {"lean_deg": 10.0}, "lean_towards_deg"),
    (_LEG | {"young_pa": 1e9}, "axial_n_m is unknown"),
    ({"length_m": 0.01, "relaxation_s": 1e-4}, "axial_n_m"),
    ({"lean_deg": 10.0}, "length_m"),
]


@dataclass(frozen=True)
class Machine:
    """What a machine's file states; lengths in m, masses in kg."""

    body: Table
    motors: tuple[Table, ...]
    feet: tuple[Table, ...]

    @property
    def text(self) -> str:
        """The file's content."""
        lines = _lines("[body]", self.body)
        for motor in self.motors:
            lines += _lines("[[motor]]", motor)
        for foot in self.feet:
            lines += _lines("[[foot]]", foot)
        return "\n".join(lines) + "\n"

    @property
    def preset(self) -> Preset:
        """The machine as its file is read; raises what the reader raises."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "drawn.toml"
            path.write_text(self.text)
            return find_preset(path)

    @property
    def config(self) -> CoSimConfig:
        """Parameters of the machine, not calibrated."""
        return self.preset.config()

    def with_body(self, **values: Any) -> "Machine":
        """Return this machine with other values of its body."""
        return replace(self, body=self.body | values)

    def heavier(self, factor: float) -> "Machine":
        """Return it with all masses and moments of inertia times a factor.

        Rotors keep their speeds: torques and voltages grow as their inertia does.
        """
        body = self.body | {"mass_kg": factor * self.body["mass_kg"]}
        if "inertia_kg_m2" in body:
            body["inertia_kg_m2"] = [factor * moment for moment in body["inertia_kg_m2"]]
        return replace(self, body=body, motors=tuple(_stronger(m, factor) for m in self.motors))

    def mirrored(self) -> "Machine":
        """Return its mirror image at the plane y = 0, mirrored by the same speeds of its motors."""
        motors = (
            m
            | {"place_m": _flip(m["place_m"]), "axis": [-m["axis"][0], m["axis"][1], -m["axis"][2]]}
            for m in self.motors
        )
        feet = (
            foot | {"place_m": _flip(foot["place_m"])} | _leaning(foot, -1.0, 0.0)
            for foot in self.feet
        )
        body = self.body | {"com_y_m": -self.body.get("com_y_m", 0.0)}
        return replace(self, body=body, motors=tuple(motors), feet=tuple(feet))

    def turned(self) -> "Machine":
        """Return it a quarter of a turn counter-clockwise: its x axis becomes its y axis."""
        motors = (
            m | {"place_m": _quarter(m["place_m"]), "axis": _quarter(m["axis"])}
            for m in self.motors
        )
        feet = (
            foot | {"place_m": _quarter(foot["place_m"])} | _leaning(foot, 1.0, 90.0)
            for foot in self.feet
        )
        x, y = self.body.get("com_x_m", 0.0), self.body.get("com_y_m", 0.0)
        body = self.body | {"com_x_m": -y, "com_y_m": x}
        if "inertia_kg_m2" in body:
            i_xx, i_yy, i_zz = body["inertia_kg_m2"]
            body["inertia_kg_m2"] = [i_yy, i_xx, i_zz]
        return replace(self, body=body, motors=tuple(motors), feet=tuple(feet))

    def permuted(self, motors: list[int], feet: list[int]) -> "Machine":
        """Return it with its motors and feet in other orders."""
        return replace(
            self,
            motors=tuple(self.motors[k] for k in motors),
            feet=tuple(self.feet[k] for k in feet),
        )


def _lines(heading: str, table: Table) -> list[str]:
    return ["", heading, *(f"{name} = {value!r}" for name, value in table.items())]


def _flip(place: list[float]) -> list[float]:
    return [place[0], -place[1], *place[2:]]


def _quarter(place: list[float]) -> list[float]:
    return [-place[1], place[0], *place[2:]]


def _leaning(foot: Table, sign: float, turned_deg: float) -> Table:
    """Return where a leg leans in a mirrored or turned machine; nothing of a rigid foot."""
    towards = foot.get("lean_towards_deg")
    return {} if towards is None else {"lean_towards_deg": sign * towards + turned_deg}


def _stronger(motor: Table, factor: float) -> Table:
    """Return a motor with all its torques and inertia times a factor, its speeds unchanged."""
    usual = TABLE_II._asdict() | motor
    grown = {name: factor * usual[name] for name in ("m", "J", "b", "c")}
    root = math.sqrt(factor)
    return motor | grown | {n: root * usual[n] for n in ("K_T", "K_p", "K_i", "V_s_max")}


def _between(low: float, high: float) -> st.SearchStrategy[float]:
    """Return numbers with uniform logarithms."""
    return st.floats(math.log(low), math.log(high)).map(math.exp)


@st.composite
def machines(
    draw: st.DrawFn,
    motors: tuple[int, int] = MOTORS,
    feet: tuple[int, int] = FEET,
    masses_kg: tuple[float, float] = MASSES_KG,
) -> Machine:
    """Draw a valid machine.

    Its feet stand around its centre of mass, which is low enough for slopes of some 10°. Motors are
    anywhere in its body, with shafts in any direction; all together could lift it at some
    500 to 1500 rad/s.

    Args:
        motors, feet: least and largest number of them.
    """
    mass_kg, diameter_m = draw(_between(*masses_kg)), draw(_between(0.02, 0.2))
    rim_m = 0.5 * diameter_m
    height_m = draw(st.floats(0.3, 1.5)) * diameter_m
    spread = draw(st.floats(0.4, 0.98)) * rim_m  # of the feet
    body: Table = {
        "mass_kg": mass_kg,
        "diameter_m": diameter_m,
        "height_m": height_m,
        "com_height_m": min(draw(st.floats(0.2, 1.5)) * spread, 0.6 * height_m),
        "mu": draw(st.floats(0.02, 1.0)),
    }
    if draw(st.booleans()):
        body |= {f"com_{n}_m": draw(st.floats(-0.15, 0.15)) * spread for n in "xy"}
    if draw(st.booleans()):
        x2, y2, z2 = (draw(st.floats(0.05, 0.3)) * rim_m**2 for _ in range(3))
        body["inertia_kg_m2"] = [mass_kg * moment for moment in (y2 + z2, x2 + z2, x2 + y2)]
    count = draw(st.integers(*feet))
    standing = []
    for k in range(count):
        angle = TURN / count * (k + draw(st.floats(0.0, 0.3)))
        radius = spread * draw(st.floats(0.8, 1.0))
        standing.append({"place_m": [radius * math.cos(angle), radius * math.sin(angle)]})
    if draw(st.booleans()):
        standing[0]["mu"] = draw(st.floats(0.02, 1.0))  # own µ, of one foot or of all
        if draw(st.booleans()):
            del body["mu"]
            standing = [foot | {"mu": draw(st.floats(0.02, 1.0))} for foot in standing]
    shafts = [draw(_motor(rim_m, height_m)) for _ in range(draw(st.integers(*motors)))]
    lifting_rad_s = draw(st.floats(500.0, 1500.0))
    unbalance = mass_kg * TABLE_II.g / lifting_rad_s**2 / len(shafts)
    r = draw(_between(0.0005, 0.003)) * diameter_m / 0.05
    scale = unbalance * r / (TABLE_II.m * TABLE_II.r**2)
    own = _stronger({}, scale) | {"m": unbalance / r, "r": r}
    return Machine(body, tuple(shaft | own for shaft in shafts), tuple(standing))


@st.composite
def legged(draw: st.DrawFn, feet: int, masses_kg: tuple[float, float] = MASSES_KG) -> Machine:
    """Draw a valid machine on elastic legs, each with its own lean, stiffness and damping."""
    machine = draw(machines(feet=(feet, feet), masses_kg=masses_kg))
    weight_n, standing = TABLE_II.g * machine.body["mass_kg"], []
    for foot in machine.feet:
        bounce_rad_s, lean = TURN * draw(_between(30.0, 200.0)), draw(st.floats(1.0, 40.0))
        stiffer, sine_2 = draw(_between(1.0, 30.0)), math.sin(math.radians(lean)) ** 2
        upright = machine.body["mass_kg"] * bounce_rad_s**2 / feet
        bending = upright * ((1.0 - sine_2) / stiffer + sine_2)
        leg = {
            "lean_deg": lean,
            "lean_towards_deg": draw(st.floats(-180.0, 180.0)),
            "bending_n_m": bending,
            "axial_n_m": stiffer * bending,
            "damping_ratio": draw(_between(0.05, 1.0)),
            "length_m": 6.0 * max(weight_n / bending, TABLE_II.g / (TURN * 30.0) ** 2),
        }
        standing.append(foot | leg)
    return replace(machine, feet=tuple(standing))


@st.composite
def _motor(draw: st.DrawFn, rim_m: float, height_m: float) -> Table:
    """Draw place and shaft of a motor."""
    axis = draw(st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: math.hypot(*v) > 0.1))
    angle, radius = draw(st.floats(0.0, TURN)), draw(st.floats(0.0, 0.98)) * rim_m
    height = draw(st.floats(0.05, 0.9)) * height_m
    place = [radius * math.cos(angle), radius * math.sin(angle), height]
    return {"place_m": place, "axis": list(axis)}


@st.composite
def broken(draw: st.DrawFn) -> tuple[Machine, str]:
    """Draw a machine that is invalid in one thing, and a word that its refusal must have."""
    machine = draw(machines())
    rim_m = 0.5 * machine.body["diameter_m"]
    motor, foot = machine.motors[0], machine.feet[0]
    outside = [1.01 * rim_m, 0.0]

    def with_motor(**values: Any) -> Machine:
        return replace(machine, motors=(motor | values, *machine.motors[1:]))

    def with_foot(**values: Any) -> Machine:
        return replace(machine, feet=(foot | values, *machine.feet[1:]))

    return draw(
        st.sampled_from(
            [
                (machine.with_body(mass_kg=0.0), "mass_kg"),
                (machine.with_body(diameter_m=-0.05), "diameter_m"),
                (machine.with_body(colour=1.0), "colour"),
                (machine.with_body(com_x_m=rim_m), "falls over"),
                (with_motor(place_m=[*outside, 0.003]), "outside the body"),
                (with_motor(axis=[0.0, 0.0, 0.0]), "no length"),
                (with_motor(J=0.0), "J"),
                (with_foot(place_m=outside), "outside the body"),
                (with_foot(place_m=[*foot["place_m"], 1e-4]), "above the floor"),
                (with_foot(mu=-0.1), "mu"),
                *((with_foot(**leg), word) for leg, word in BROKEN_LEGS),
                (replace(machine, feet=machine.feet[-1:]), "falls over"),
                (replace(machine, motors=machine.motors[:1] * 9), "motor"),
            ]
        )
    )
