"""Measure the cost of one exchange with a motor FMU: set an input, step 1e-5 s, get two outputs.

Through fmpy from Python, by the compiled calls of the co-simulation's driver, and as the same
equations inlined in one numba kernel: the floor. The three are first checked for the same bits, so
that they are known to do the same work; only the built-in FMU has an inlined twin.
"""

import time
from dataclasses import dataclass

import numpy as np

from benchmarks.timing import best_s
from cosim.base.command import Checked, Count, MotorFmuFile
from cosim.base.jit import kernel
from cosim.coupling.calls import do_step
from cosim.coupling.fmu import Addresses, MotorFmu
from cosim.fmi.abi import exchange_3
from cosim.model.params import FIG_7, TABLE_II, TIMING, MotorParams
from fmus.build import cached_fmu

INPUT, OUTPUTS = "omega_noise", ("theta", "omega")


@dataclass(frozen=True, kw_only=True)
class Options(Checked):
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


def measure(options: Options) -> dict[str, float]:
    fmu = MotorFmu(options.motor_fmu or cached_fmu("VibrationMotor"))
    known = {v.name: v.valueReference for v in fmu.description.modelVariables}
    references = np.array([known[name] for name in (INPUT, *OUTPUTS)], dtype=np.uint32)
    inputs, outputs = references[:1].tolist(), references[1:].tolist()
    start = {"omega_des": FIG_7.omega_des}
    by_python, by_calls = fmu.instantiate("python", start), fmu.instantiate("calls", start)
    state, dt = np.zeros(3), TIMING.dt_s
    generator, count = np.random.default_rng(0), options.exchanges
    many, few = (generator.uniform(-35.0, 35.0, n) for n in (count, max(count // 50, 1)))
    done = {"fmpy": 0, "compiled": 0}
    out = np.empty((count, 2))

    def run_fmpy(noise: np.ndarray) -> np.ndarray:
        slave, rows = by_python.slave, []
        for value in noise.tolist():
            slave.setFloat64(inputs, [value])
            slave.doStep(done["fmpy"] * dt, dt)
            rows.append(slave.getFloat64(outputs))
            done["fmpy"] += 1
        return np.array(rows)

    def run_compiled(noise: np.ndarray) -> np.ndarray:
        room = out[: len(noise)]
        arguments = (by_calls.addresses, by_calls.instance, references, noise, room)
        assert compiled(*arguments, done["compiled"], dt) == 0
        done["compiled"] += len(noise)
        return room

    def run_inlined(noise: np.ndarray) -> np.ndarray:
        inlined(TABLE_II, FIG_7.omega_des, state, noise, out[: len(noise)], dt)
        return out[: len(noise)]

    # compiles too, and warms every cache
    results = [run(few).copy() for run in (run_fmpy, run_compiled, run_inlined)]
    if not (results[0] == results[1]).all():
        raise AssertionError("fmpy and the compiled driver give different bits")
    if options.motor_fmu is None and not (results[1] == results[2]).all():
        raise AssertionError("the FMU and its inlined twin give different bits")

    seconds = best_s(
        options.rounds,
        lambda: run_fmpy(few),
        lambda: run_compiled(many),
        lambda: run_inlined(many),
        clock=time.perf_counter,
    )
    by_python.close()
    by_calls.close()
    ns = [1e9 * s / n for s, n in zip(seconds, (len(few), count, count), strict=True)]
    return {
        "ns_fmpy": ns[0],
        "ns_compiled": ns[1],
        "ns_inlined": ns[2],
        "ratio_fmpy_to_compiled": ns[0] / ns[1],
        "ratio_compiled_to_inlined": ns[1] / ns[2],
    }
