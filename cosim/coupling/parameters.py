"""Parameters of a motor FMU, read from an instance: never those of another motor."""

from dataclasses import replace
from pathlib import Path

from cosim.base.arguments import ConfigError
from cosim.base.provenance import digest_of
from cosim.coupling.fmu import FmuError, MotorFmu
from cosim.model.config import GIVEN, UNKNOWN, CoSimConfig, proportional
from cosim.model.params import TABLE_II, MotorParams, lift_off_speed
from fmus.build import is_built_in

_OF_BODY = ("m", "r", "J", "g")  # also in Eq. (3)


def with_motor(config: CoSimConfig, motor_fmu: Path) -> CoSimConfig:
    """Return a configuration with the parameters that a motor FMU reports.

    What the configuration says of motors other than Table II, and its `motor_parameters`, are set
    first. A parameter that the FMU does not expose is unknown; the body has the configuration's
    value of those in Eq. (3). The built-in FMU has the configuration's values.

    Args:
        config: of the co-simulation, not yet calibrated.
        motor_fmu: of every motor.

    Raises:
        FmuError: the FMU cannot be used, lacks a parameter that is set or needed, or has one that
            no motor can have.
    """
    if is_built_in(motor_fmu) or config.motor_fmu:
        return config
    fmu, motor = MotorFmu(motor_fmu), config.motor._asdict()
    given = {name: value for name, value in motor.items() if value != getattr(TABLE_II, name)}
    given |= dict(config.motor_parameters)
    found = fmu.read(MotorParams._fields, given)
    name, sources = f"motor FMU {motor_fmu.name}", dict(config.sources)
    tree = {n: (v, sources.get(n, GIVEN) if n in given else name) for n, v in found.items()}
    # A parameter that is not exposed keeps its value, in the body.
    body: dict[str, str] = dict.fromkeys(_OF_BODY, f"{UNKNOWN}: that of the body is assumed")
    tree |= {n: (v, body.get(n, UNKNOWN)) for n, v in motor.items() if n not in found}
    robot, read = config.robot, config.motor._replace(**found)
    share = lift_off_speed(robot, read) / lift_off_speed(robot, config.motor)
    tree |= proportional(config.steering, share)
    of_fmu = {"motor_parameters": tuple(given.items()), "motor_fmu": digest_of(motor_fmu)}
    try:
        config = replace(config.merged(tree), **of_fmu)
    except ConfigError as error:
        raise FmuError(f"{name}: {error}") from None
    if "motors" in config.open_loop:
        config.require_known("--open-loop motors", "K_T", "R", "b", "c")
    return config
