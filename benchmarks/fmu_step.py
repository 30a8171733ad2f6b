"""Measure the cost of one exchange with a motor FMU: set an input, step 1e-5 s, get two outputs.

It times, in turns in one run, fmpy from Python, the compiled calls of
the co-simulation's driver, and the same equations inlined in one numba kernel: the floor. The three
are first checked for the same bits, so that they are known to do the same work.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cosim.base.command import MotorFmuFile
from cosim.base.jit import kernel
from cosim.coupling.calls import do_step
from cosim.coupling.fmu import Addresses, Motor, MotorFmu
from cosim.fmi.abi import exchange_3
from cosim.model.params import FIG_7, TABLE_II, TIMING, MotorParams
from fmus.build import cached_fmu
from minirobots.options import CommandOptions, Count

INPUT, OUTPUTS = "omega_noise", ("theta", "omega")


@dataclass(frozen=True, kw_only=True)
class Options(CommandOptions):
    """Time one exchange with the motor FMU by three drivers.

    Only the built-in FMU has an inlined twin with the same bits.
    """

    motor_fmu: MotorFmuFile = None
    exchanges: Count = 20_000
    """Exchanges per round and compiled driver; fmpy makes a fiftieth of them."""
    rounds: Count = 200
    """Rounds; the drivers take turns, and the fastest round of each counts: short and many, so that
    another process on the machine spoils some rounds and not the result."""


@kernel
def compiled(calls: Addresses, instance: int, references: np.ndarray, noise: np.ndarray,
             out: np.ndarray, first: int, dt: float) -> int:  # fmt: skip
    """Exchange through the FMU's C functions; `out` is (n, 2), `noise` (n,)."""
    worst, where, inputs = 0, references.ctypes.data, noise.ctypes.data
    results = out.ctypes.data
    for k in range(noise.shape[0]):
        status = exchange_3(calls.set_float64, (instance, where, 1, inputs + 8 * k, 1))
        worst = max(worst, status)
        worst = max(worst, do_step(calls.do_step, instance, (first + k) * dt, dt))
        status = exchange_3(calls.get_float64, (instance, where + 4, 2, results + 16 * k, 2))
        worst = max(worst, status)
    return worst


@kernel
def sine(x: float) -> float:
    """The sine of sine.h, operation by operation, for angles that are no nonsense."""
    q = (x * 0.3183098861837907 + 6755399441055744.0) - 6755399441055744.0
    y = (x - q * 3.1415926534682512) - (q * 1.2154201018028943e-10 + q * -5.016557612668332e-20)
    z = y * y
    z2 = z * z
    low = (-0.16666666666666666 + z * 0.008333333333333194) + z2 * (
        -0.00019841269841209218 + z * 2.755731921113729e-06
    )
    high = (-2.5052106872803487e-08 + z * 1.6058939705952331e-10) + z2 * (
        -7.642991490630542e-13 + z * 2.721174975454819e-15
    )
    s = y + (y * z) * (low + (z2 * z2) * high)
    half = (0.5 * q + 6755399441055744.0) - 6755399441055744.0
    return s if q - 2.0 * half == 0.0 else -s


@kernel
def inlined(p: MotorParams, omega_des: float, state: np.ndarray, noise: np.ndarray,
            out: np.ndarray, h: float) -> None:  # fmt: skip
    """The motor's equations as in motor.h, in closed loop; `state` is theta, omega, integral."""
    theta, omega, integral = state[0], state[1], state[2]
    torque_per_volt, damping = p.K_T / p.R, p.b + p.K_T * p.K_T / p.R
    weight, inverse_J = p.m * p.g * p.r, 1.0 / p.J
    sin_theta = sine(theta)
    for k in range(noise.shape[0]):
        error = omega_des - (omega + noise[k])
        u = p.K_p * error + p.K_i * integral
        voltage = p.V_s_max if u > p.V_s_max else -p.V_s_max if u < -p.V_s_max else u
        torque = torque_per_volt * voltage - damping * omega - weight * sin_theta
        free, friction = omega + h * inverse_J * torque, h * inverse_J * p.c
        if not ((u > p.V_s_max and error > 0.0) or (u < -p.V_s_max and error < 0.0)):
            integral += h * error
        omega = free - friction if free > friction else free + friction if free < -friction else 0.0
        theta += h * omega
        sin_theta = sine(theta)
        out[k, 0], out[k, 1] = theta, omega
    state[0], state[1], state[2] = theta, omega, integral


def through_fmpy(motor: Motor, references: list[int], noise: np.ndarray, first: int, dt: float):
    """Exchange through fmpy's Python classes; returns (n, 2)."""
    slave, rows = motor.slave, []
    for k, value in enumerate(noise.tolist()):
        slave.setFloat64(references[:1], [value])
        slave.doStep((first + k) * dt, dt)
        rows.append(slave.getFloat64(references[1:]))
    return np.array(rows)


def measure(motor_fmu: Path | None, exchanges: int, rounds: int) -> dict[str, float]:
    """Time per exchange of each driver in ns, and their ratios."""
    fmu = MotorFmu(motor_fmu or cached_fmu("VibrationMotor"))
    known = {v.name: v.valueReference for v in fmu.description.modelVariables}
    names = [INPUT, *OUTPUTS]
    references = np.array([known[name] for name in names], dtype=np.uint32)
    start = {"omega_des": FIG_7.omega_des}
    by_python, by_calls = fmu.instantiate("python", start), fmu.instantiate("calls", start)
    state, dt, count = np.zeros(3), TIMING.dt_s, exchanges
    few = max(count // 50, 1)
    generator = np.random.default_rng(0)
    done = {"fmpy": 0, "compiled": 0, "inlined": 0}
    out = np.empty((count, 2))

    def run_fmpy(noise: np.ndarray) -> np.ndarray:
        return through_fmpy(by_python, references.tolist(), noise, done["fmpy"], dt)

    def run_compiled(noise: np.ndarray) -> np.ndarray:
        room = out[: len(noise)]
        arguments = (by_calls.addresses, by_calls.instance, references, noise, room)
        assert compiled(*arguments, done["compiled"], dt) == 0
        return room

    def run_inlined(noise: np.ndarray) -> np.ndarray:
        inlined(TABLE_II, FIG_7.omega_des, state, noise, out[: len(noise)], dt)
        return out[: len(noise)]

    drivers: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "fmpy": run_fmpy,
        "compiled": run_compiled,
        "inlined": run_inlined,
    }
    noise = generator.uniform(-35.0, 35.0, few)
    results = []
    for name, driver in drivers.items():  # compiles too, and warms every cache
        results.append(driver(noise).copy())
        done[name] += few
    if not (results[0] == results[1]).all():
        raise AssertionError("fmpy and the compiled driver give different bits")
    if motor_fmu is None and not (results[1] == results[2]).all():
        raise AssertionError("the FMU and its inlined twin give different bits")

    best = dict.fromkeys(drivers, math.inf)
    for _ in range(rounds):
        for name, driver in drivers.items():
            noise = generator.uniform(-35.0, 35.0, few if name == "fmpy" else count)
            begin = time.perf_counter_ns()
            driver(noise)
            best[name] = min(best[name], (time.perf_counter_ns() - begin) / len(noise))
            done[name] += len(noise)
    by_python.close()
    by_calls.close()
    return {
        "ns_fmpy": best["fmpy"],
        "ns_compiled": best["compiled"],
        "ns_inlined": best["inlined"],
        "ratio_fmpy_to_compiled": best["fmpy"] / best["compiled"],
        "ratio_compiled_to_inlined": best["compiled"] / best["inlined"],
    }
