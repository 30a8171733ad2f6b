"""Small FMUs of FMI 2.0 and 3.0 to couple: their descriptions, and the one library of `models.c`.

They are the models of the reference FMUs of the Modelica Association, written again and solved in
closed form, so that what a master makes wrong is all that is wrong; and an oscillator to couple
with another one.
"""

import hashlib
import subprocess
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple
from xml.sax.saxutils import quoteattr

from fmpy import platform, platform_tuple, sharedLibraryExtension

from cosim.base.storage import cache_dir, cached
from fmus.compiler import FLAGS, BuildError, compiler_command, compiler_version, fmi_headers

SOURCE = Path(__file__).with_name("models.c")
_UNITS = {
    "N": 'kg="1" m="1" s="-2"',
    "m": 'm="1"',
    "mm": 'm="1" factor="0.001"',
    "s": 's="1"',
}
_OF_FMI_2 = {"Float64": "Real", "Int32": "Integer", "Boolean": "Boolean", "String": "String"} | {
    "Enumeration": "Enumeration"
}
_KINDS = ("Float64", "Int32", "Boolean", "Enumeration", "Float32", "Int8", "UInt8", "Int16",
          "UInt16", "UInt32", "Int64", "UInt64", "String")  # fmt: skip


class Variable(NamedTuple):
    """A variable of a small model.

    Attributes:
        slot: in `models.c`, its value reference.
        name: of the variable.
        kind: its type in FMI 3.0.
        causality: of the variable.
        start: value, as text.
        unit: one of those that are defined here.
        needs: slots of inputs that an output depends on.
        size: slot of the structural parameter that is its dimension.
        of: slot of the state that it is the derivative of.
        clocks: slots of the clocks that it is tied to, as text.
        ticks: attributes of a clock.
    """

    slot: int
    name: str
    kind: str = "Float64"
    causality: str = "output"
    start: str | None = None
    unit: str | None = None
    needs: tuple[int, ...] = ()
    size: int | None = None
    of: int | None = None
    clocks: str | None = None
    ticks: str = ""


def _feedthrough() -> Iterable[Variable]:
    """Inputs of all types, each with the output that it is passed on to."""
    starts = {"Boolean": "false", "Enumeration": "1", "String": "none"}
    for k, kind in enumerate(_KINDS):
        slot = 2 * k + 2
        yield Variable(slot, f"{kind}_input", kind, "input", starts.get(kind, "0"))
        yield Variable(slot + 1, f"{kind}_output", kind, needs=(slot,))


_EVERY = 'intervalVariability="constant" intervalDecimal="{}"'
_TIME = Variable(0, "time", causality="independent", unit="s")
MODELS = {
    "oscillator": (
        Variable(1, "m", causality="parameter", start="1"),
        Variable(2, "k", causality="parameter", start="1"),
        Variable(3, "k_c", causality="parameter", start="0"),
        Variable(4, "x", start="1", unit="m"),
        Variable(5, "v", start="0"),
        Variable(6, "F_in", causality="input", start="0", unit="N"),
        Variable(7, "x_in", causality="input", start="0", unit="m"),
        Variable(8, "F", unit="N", needs=(7, 10)),
        Variable(9, "c_c", causality="parameter", start="0"),
        Variable(10, "v_in", causality="input", start="0"),
        Variable(11, "moves", causality="parameter", start="0"),  # 1: x_in is the integral of v_in
    ),
    "dahlquist": (
        Variable(1, "k", causality="parameter", start="1"),
        Variable(2, "x", start="1"),
        Variable(3, "u", causality="input", start="0"),
        Variable(4, "fails_at", causality="parameter", start="1e300", unit="s"),
        Variable(5, "longest", causality="parameter", start="1e300", unit="s"),
        Variable(6, "warns_above", causality="parameter", start="1e300"),
        Variable(7, "needs_stop", causality="parameter", start="0.0"),
        Variable(8, "double_k", causality="calculatedParameter"),
    ),
    "ball": (
        Variable(1, "h", start="1"),
        Variable(2, "v", start="0"),
        Variable(3, "g", causality="parameter", start="9.81"),
        Variable(4, "e", causality="parameter", start="0.7"),
    ),
    "stair": (
        Variable(1, "counter", "Int32", start="1"),
        Variable(2, "last", "Int32", "parameter", start="10"),
    ),
    "restless": (
        Variable(1, "mood", "Int32", "parameter", "0"),  # 1: never content, 2: wants to end
        Variable(2, "x", start="0"),
    ),
    "curve": (
        Variable(1, "kind", "Int32", "parameter", "0"),  # y = a u + w; cos u, u², √u in place of u
        Variable(2, "a", causality="parameter", start="1"),
        Variable(3, "u", causality="input", start="0"),
        Variable(4, "w", causality="input", start="0"),
        Variable(5, "y", needs=(3, 4)),
        Variable(6, "count", "Int32", "input", "0"),
        Variable(7, "next", "Int32", needs=(6,)),  # count + 1
    ),
    "namer": (Variable(1, "name", "String"),),  # "step 2" after 2 s
    "van_der_pol": (
        Variable(1, "x0", start="2"),
        Variable(2, "x1", start="0"),
        Variable(3, "mu", causality="parameter", start="1"),
        Variable(4, "ends_at", causality="parameter", start="1e300"),
        Variable(5, "turns", "Int32", start="0"),  # of the sign of x0
    ),
    "ticker": (
        Variable(1, "a", "Clock", "input", ticks=_EVERY.format("0.003")),
        Variable(2, "b", "Clock", "input", ticks=_EVERY.format("0.005")),
        Variable(3, "y", causality="input", start="0", clocks="1"),
        Variable(4, "u", start="0", needs=(3,), clocks="1"),
        Variable(5, "r", causality="parameter", start="0"),
        Variable(6, "kp", causality="parameter", start="0"),
        Variable(7, "ki", causality="parameter", start="0"),  # times the interval
        Variable(8, "ticks_a", "Int32", start="0", clocks="1"),
        Variable(9, "ticks_b", "Int32", start="0", clocks="2"),
        Variable(10, "both", "Int32", start="0"),
        Variable(11, "interval", causality="parameter", start="0.1", unit="s"),
        Variable(12, "shift", causality="parameter", start="0", unit="s"),
        Variable(13, "kind", "Int32", "parameter", "0"),  # of what follows a tick, see `models.c`
        Variable(14, "go", "Int32", "input", "0"),
        Variable(16, "last_s", start="0"),
        Variable(17, "now_s", start="0", clocks="1"),
        Variable(19, "event_s", causality="parameter", start="1e300", unit="s"),
    ),
    "feedthrough": tuple(_feedthrough()),
    "array": (
        Variable(1, "n", "UInt64", "structuralParameter", "3"),
        Variable(2, "u", "Float64", "input", "0 0 0", size=1),
        Variable(3, "y", "Float64", needs=(2,), size=1),
    ),
}

# Slots of states, of models for Model Exchange; their derivatives have 40 and 41.
STATES = {"oscillator": (4, 5), "dahlquist": (2,), "ball": (1, 2), "van_der_pol": (1, 2)}


def small_fmu(
    path: Path,
    model: str,
    fmi: int,
    *,
    units: Mapping[str, str] | None = None,
    able: bool = True,
    told: bool = True,
    internal_s: float | None = None,
    interfaces: tuple[str, ...] = ("CoSimulation",),
) -> Path:
    """Write one of `MODELS` as an FMU for this machine.

    Args:
        path: of the FMU.
        model: a key of `MODELS`.
        fmi: 2 or 3.
        units: by variables, instead of the usual ones.
        able: whether it says that its state can be saved, and its step varied.
        told: whether it says what outputs depend on.
        internal_s: fixed internal step that it says it has, in FMI 3.0.
        interfaces: elements of those that it has, "ModelExchange" among them.
    """
    named = units or {}
    variables = [v._replace(unit=named.get(v.name, v.unit)) for v in (_TIME, *MODELS[model])]
    if fmi == 2:
        variables = [v for v in variables if v.kind in _OF_FMI_2]
    if "ModelExchange" in interfaces:
        variables += [
            Variable(40 + k, f"der{k}", causality="local", of=state)
            for k, state in enumerate(STATES.get(model, ()))
        ]
    text = (_description_2 if fmi == 2 else _description_3)(model, variables, able, told)
    if internal_s is not None:
        fixed = f'<CoSimulation fixedInternalStepSize="{internal_s}"'
        text = text.replace("<CoSimulation", fixed)
    if "ModelExchange" in interfaces:
        begin, end = text.index("<CoSimulation"), text.index("<UnitDefinitions")
        stepped = text[begin:end] if "CoSimulation" in interfaces else ""
        state = "canGetAndSetFMUstate" if fmi == 2 else "canGetAndSetFMUState"
        words = "" if fmi == 2 else ' needsCompletedIntegratorStep="true"'
        words += f' {state}="{str(able).lower()}"'
        exchanged = f'<ModelExchange modelIdentifier="{model}"{words}/>'
        text = text[:begin] + exchanged + stepped + text[end:]
    folder = platform if fmi == 2 else platform_tuple
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)
        name = f"binaries/{folder}/{model}{sharedLibraryExtension}"
        archive.writestr(name, _library())
    return path


def _library() -> bytes:
    """The compiled models, from the cache."""
    name = f"{source_key([SOURCE])}{sharedLibraryExtension}"

    def make() -> bytes:
        return compile_c([SOURCE], [fmi_headers()], FLAGS)

    path = cache_dir("fmus") / f"small-{name}"
    return cached(path, Path.read_bytes, make, lambda content, place: place.write_bytes(content))


def source_key(sources: Iterable[Path]) -> str:
    """Return what names a library in the cache: a hash of its sources and its compiler."""
    found = hashlib.sha256(repr((compiler_version(), FLAGS)).encode())
    for source in sources:
        found.update(source.read_bytes())
    return found.hexdigest()[:16]


def compile_c(sources: Iterable[Path], folders: Iterable[Path], flags: Iterable[str]) -> bytes:
    """A shared library for this machine.

    Args:
        sources: C files.
        folders: with header files.
        flags: of the compiler.

    Raises:
        BuildError: no compiler was found, or it failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / f"library{sharedLibraryExtension}"
        headers = [f"-I{each}" for each in folders]
        command = [*compiler_command(), *flags, *headers, *map(str, sources), "-o", str(output)]
        done = subprocess.run([*command, "-lm"], capture_output=True, text=True, check=False)
        if done.returncode:
            raise BuildError(f"the C compiler failed: {done.stderr.strip()}")
        return output.read_bytes()


def _attributes(v: Variable, **others: str | None) -> str:
    """Attributes that both standards have at a variable, and others."""
    output = v.causality in ("output", "calculatedParameter")
    fixed = {"parameter": "fixed", "structuralParameter": "fixed", "calculatedParameter": "fixed"}
    changing = "continuous" if v.kind.startswith("Float") and not v.clocks else "discrete"
    values = {
        "name": v.name,
        "valueReference": str(v.slot),
        "causality": v.causality,
        "variability": fixed.get(v.causality, changing),
        "initial": ("exact" if v.start else "calculated") if output or v.of else None,
        **others,
    }
    return " ".join(f"{k}={quoteattr(value)}" for k, value in values.items() if value is not None)


def _unit_definitions() -> str:
    units = "".join(f'<Unit name="{n}"><BaseUnit {base}/></Unit>' for n, base in _UNITS.items())
    return f"<UnitDefinitions>{units}</UnitDefinitions>"


def _description_3(model: str, variables: list[Variable], able: bool, told: bool) -> str:
    flag = str(able).lower()
    elements, unknowns = "", ""
    for v in variables:
        declared = "Option" if v.kind == "Enumeration" else None
        derivative = None if v.of is None else str(v.of)
        text = v.kind == "String"
        attributes = _attributes(
            v, start=None if text else v.start, unit=v.unit, declaredType=declared,
            derivative=derivative, clocks=v.clocks,
        )  # fmt: skip
        if v.kind == "Clock":
            attributes = f'name="{v.name}" valueReference="{v.slot}" causality="input" {v.ticks}'
        dimension = f'<Dimension valueReference="{v.size}"/>' if v.size else ""
        inner = f'<Start value="{v.start}"/>' * (text and v.start is not None) + dimension
        elements += f"<{v.kind} {attributes}>{inner}</{v.kind}>\n"
        needs = f' dependencies="{" ".join(map(str, v.needs))}"' if told else ""
        unknowns += f'<Output valueReference="{v.slot}"{needs}/>' * (v.causality == "output")
    for v in variables:
        unknowns += f'<ContinuousStateDerivative valueReference="{v.slot}"/>' * (v.of is not None)
    for v in variables:
        initial = v.of is not None or v.causality == "calculatedParameter"
        unknowns += f'<InitialUnknown valueReference="{v.slot}"/>' * initial
    if model == "ball":
        unknowns += '<EventIndicator valueReference="1"/>'
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="{model}" instantiationToken="{model}">
<CoSimulation modelIdentifier="{model}" canGetAndSetFMUState="{flag}"
  canHandleVariableCommunicationStepSize="{flag}" hasEventMode="true"/>
{_unit_definitions()}
<TypeDefinitions><EnumerationType name="Option"><Item name="one" value="1"/>
<Item name="two" value="2"/></EnumerationType></TypeDefinitions>
<ModelVariables>{elements}</ModelVariables>
<ModelStructure>{unknowns}</ModelStructure>
</fmiModelDescription>"""


def _description_2(model: str, variables: list[Variable], able: bool, told: bool) -> str:
    flag = str(able).lower()
    text, unknowns = "", ""
    places = {v.slot: k for k, v in enumerate(variables, 1)}
    for v in variables:
        kind = _OF_FMI_2[v.kind]
        values = {"start": v.start, "unit": v.unit if kind == "Real" else None}
        values["derivative"] = None if v.of is None else str(places[v.of])
        values["declaredType"] = "Option" if kind == "Enumeration" else None
        inner = " ".join(f'{k}="{value}"' for k, value in values.items() if value is not None)
        text += f"<ScalarVariable {_attributes(v)}><{kind} {inner}/></ScalarVariable>\n"
        needs = f' dependencies="{" ".join(str(places[n]) for n in v.needs)}"' if told else ""
        unknowns += f'<Unknown index="{places[v.slot]}"{needs}/>' * (v.causality == "output")
    states = "".join(f'<Unknown index="{places[v.slot]}"/>' for v in variables if v.of is not None)
    structure = f"<Outputs>{unknowns}</Outputs>"
    if states:
        structure += f"<Derivatives>{states}</Derivatives>"
    first = "".join(
        f'<Unknown index="{places[v.slot]}"/>'
        for v in variables
        if v.of is not None or v.causality == "calculatedParameter"
    )
    if first:
        structure += f"<InitialUnknowns>{first}</InitialUnknowns>"
    indicators = ' numberOfEventIndicators="1"' if model == "ball" else ""
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{model}" guid="{model}"{indicators}>
<CoSimulation modelIdentifier="{model}" canGetAndSetFMUstate="{flag}"
  canHandleVariableCommunicationStepSize="{flag}"/>
{_unit_definitions()}
<TypeDefinitions><SimpleType name="Option"><Enumeration><Item name="one" value="1"/>
<Item name="two" value="2"/></Enumeration></SimpleType></TypeDefinitions>
<ModelVariables>{text}</ModelVariables>
<ModelStructure>{structure}</ModelStructure>
</fmiModelDescription>"""
