"""Start values of the motor's variables, from the hand-written description of its FMU."""

from fmus.description import read_description, start_of, variables_of


def motor_starts() -> dict[str, float]:
    """Start values by name; an option is a number, too."""
    variables = variables_of(read_description("VibrationMotor"))
    return {v.attrib["name"]: start_of(v) for v in variables if v.get("start")}
