"""n motors in one instance give the bits of n instances of one motor, whatever becomes of them."""

from typing import Any

import numpy as np
import pytest

from tests.fmus.starts import motor_starts

OK = 0
STEP_S = 1e-5
NAMES = ("theta", "omega", "omega_dot", "V_s", "i", "u", "integral")
START = motor_starts()
PARAMETERS = ("m", "r", "K_T", "J", "R", "b", "c", "g", "K_p", "K_i", "V_s_max")


class Singles:
    """One instance of VibrationMotor for each motor."""

    def __init__(self, instance: Any, start: dict[str, Any], n: int) -> None:
        self.instance, self.inputs = instance, [{} for _ in range(n)]
        self.start = [{k: float(np.broadcast_to(v, n)[j]) if k != "closed_loop" else v
                       for k, v in start.items()} for j in range(n)]  # fmt: skip
        self.motors = [self._new(k, 0.0) for k in range(n)]

    def _new(self, k: int, time_s: float) -> Any:
        return self.instance(3).start(time_s, **self.start[k], **self.inputs[k])

    def set(self, **values: np.ndarray) -> None:
        for k, motor in enumerate(self.motors):
            self.inputs[k] |= {name: float(value[k]) for name, value in values.items()}
            assert motor.set(**self.inputs[k]) == OK

    def restart(self, k: int, time_s: float, parameters: dict[str, float]) -> None:
        self.start[k] |= parameters
        self.motors[k].free()
        self.motors[k] = self._new(k, time_s)

    def do_step(self, time_s: float, step_s: float) -> None:
        assert [motor.do_step(time_s, step_s) for motor in self.motors] == [OK] * len(self.motors)

    def get(self, *names: str) -> np.ndarray:
        return np.array([motor.get(*names) for motor in self.motors]).T


def parameters(generator: np.random.Generator, n: int) -> dict[str, Any]:
    """Parameters and starts about those of Table II, different for every motor."""
    start = {p: START[p] * generator.uniform(0.7, 1.4, n) for p in PARAMETERS}
    start["theta_start"] = generator.uniform(-3.0, 3.0, n)
    start["omega_start"] = np.where(np.arange(n) % 3 == 0, 0.0, generator.uniform(-400, 400, n))
    return start


@pytest.mark.long
@pytest.mark.parametrize("closed_loop", [True, False], ids=["closed-loop", "open-loop"])
@pytest.mark.parametrize(("n", "step_s"), [(1, 1e-5), (4, 1e-5), (8, 2.5e-5), (21, 1e-3)])
def test_an_array_has_the_bits_of_its_motors(array, instance, n, step_s, closed_loop):
    generator = np.random.default_rng(n)
    start = parameters(generator, n) | {"closed_loop": closed_loop}
    motors, singles = array(n).start(**start), Singles(instance, start, n)
    restart, step, saved = np.zeros(n, dtype=int), 0, None
    sides, at_rest, signs = set(), 0, set()
    for stretch in range(30):
        values = {
            "omega_des": generator.choice([0.0, 700.0, -500.0, 7000.0], n),
            "omega_noise": generator.uniform(-35.0, 35.0, n),
            "d": generator.uniform(-3e-6, 3e-6, n),
            "V_in": generator.choice([0.0, 0.3, 1.0, -1.5, 9.0, -9.0], n),
        }
        assert motors.set(**values) == OK
        singles.set(**values)
        if stretch % 5 == 4:
            chosen = generator.random(n) < 0.5
            restart += chosen * generator.integers(-3, 9, n)
            chosen = restart != motors_restart(motors)
            for name, value in parameters(np.random.default_rng(stretch), n).items():
                if name in PARAMETERS:
                    start[name] = np.where(chosen, value, start[name])
                    assert motors.set(**{name: start[name]}) == OK
            assert motors.set(restart=restart) == OK
            for k in np.flatnonzero(chosen).tolist():
                singles.restart(k, step * step_s, {p: float(start[p][k]) for p in PARAMETERS})
        if stretch == 12:
            saved = motors.save()
        if stretch == 13 and saved is not None:  # there and back, in another instance
            ahead = motors.save()
            other = array(2)
            assert other.load(saved) == motors.load(saved) == OK
            assert other.save() == saved
            assert motors.load(ahead) == OK
            assert motors.save() == ahead
        for _ in range(40):
            assert motors.do_step(step * step_s, step_s) == OK, motors.messages
            singles.do_step(step * step_s, step_s)
            step += 1
            found = np.reshape(motors.get(*NAMES), (len(NAMES), n))
            assert found.tobytes() == singles.get(*NAMES).tobytes()
            at_rest += int(((found[1] == 0.0) & (found[2] == 0.0)).sum())
            signs |= set(np.sign(found[1]))
            sides |= set(np.sign(found[3][np.abs(found[3]) == start["V_s_max"]]))
    assert n == 1 or (sides == {-1.0, 1.0} and signs == {-1.0, 0.0, 1.0} and at_rest > 20)


def test_tuned_motors_go_on_from_where_they_are(array, instance):
    """As single motors do that begin there; in open loop, where the integral stays 0."""
    generator, n = np.random.default_rng(1), 11
    motors = array(n).start(**parameters(generator, n) | {"closed_loop": False})
    voltage = generator.uniform(-3.0, 3.0, n)
    assert motors.set(V_in=voltage) == OK
    assert motors.do_step(0.0, 0.02) == OK
    before = motors.get("theta", "omega")
    tuned = {p: v for p, v in parameters(generator, n).items() if p in PARAMETERS}
    assert motors.set(**tuned) == OK
    assert (motors.get("theta", "omega") == before).all()
    there = {"theta_start": before[0], "omega_start": before[1], "closed_loop": False}
    singles = Singles(instance, tuned | there, n)
    singles.set(V_in=voltage)
    assert motors.get(*NAMES).tobytes() == singles.get(*NAMES).tobytes()
    other = array(2)
    assert other.load(motors.save()) == OK  # a state holds the parameters
    other.n = n
    assert motors.do_step(0.02, 0.01) == other.do_step(0.02, 0.01) == OK
    singles.do_step(0.0, 0.01)
    found = motors.get(*NAMES)
    assert found.tobytes() == singles.get(*NAMES).tobytes() == other.get(*NAMES).tobytes()


def motors_restart(motors: Any) -> np.ndarray:
    values = np.zeros(motors.n, dtype=np.int64)
    assert motors.values("GetInt64", ("restart",), values) == OK
    return values


def test_a_saved_state_holds_the_last_restart(array):
    motors = array(3).start(omega_des=700.0)
    assert motors.do_step(0.0, 0.1) == OK
    assert motors.set(restart=[0, 5, 0]) == OK
    states = {0.1: motors.save()}  # motor 2 is to restart
    assert motors.do_step(0.1, 0.1) == OK
    states[0.2] = motors.save()  # motor 2 has restarted
    assert motors.do_step(0.2, 0.1) == OK
    assert motors.get("theta")[0, 1] < 0.8 * motors.get("theta")[0, 0]
    for time_s, saved in states.items():
        other = array(3)
        assert other.load(saved) == OK
        assert other.save() == saved
        for k in range(round((0.3 - time_s) / 0.1)):
            assert other.do_step(time_s + k * 0.1, 0.1) == OK, other.messages
        assert other.get("theta", "omega").tobytes() == motors.get("theta", "omega").tobytes()


def test_a_restart_waits_for_the_step_and_happens_once(array):
    """Also one from another angle, which acts with a restart only."""
    motors = array(2).start(omega_des=700.0, theta_start=[0.0, 1.0])
    assert motors.do_step(0.0, 0.05) == OK
    before = motors.get(*NAMES)
    assert motors.set(theta_start=[2.0, 0.5], restart=[-1, 0]) == OK
    assert (motors.get(*NAMES) == before).all()
    for k in range(3):
        assert motors.do_step(0.05 + k * STEP_S, STEP_S) == OK
    alone = array(1).start(omega_des=700.0, theta_start=2.0)
    assert alone.do_step(0.0, 3 * STEP_S) == OK
    assert (motors.get(*NAMES)[:, 0] == alone.get(*NAMES)).all()
    assert motors.get("theta")[0, 1] > before[0, 1]


@pytest.mark.parametrize(("n", "part_s"), [(1, STEP_S), (4, STEP_S), (9, 2 * STEP_S)])
def test_samples_have_the_bits_of_a_step_for_each(array, n, part_s):
    """Also with a restart in the step, and from a saved state on."""
    parts, names = 50, ("theta", "omega", "omega_dot")
    sampled_names = tuple(f"{name}_samples" for name in names)
    whole, single = array(n), array(n)
    assert whole.set_sizes(samples=parts) == OK
    for motors in (whole, single):
        motors.start(omega_des=np.linspace(300.0, 900.0, n))
    for step in range(6):
        inputs = {"restart": np.arange(n) * (step // 3), "omega_noise": 10.0 * step}
        for motors in (whole, single):
            assert motors.set(**inputs) == OK
        assert whole.do_step(step * parts * part_s, parts * part_s) == OK
        each = []
        for part in range(step * parts, (step + 1) * parts):
            assert single.do_step(part * part_s, part_s) == OK
            each.append(np.reshape(single.get(*names), (3, n)))
        kept = np.full((3, parts, n), np.nan)
        assert whole.values("GetFloat64", sampled_names, kept) == OK
        assert np.array_equal(kept, np.swapaxes(each, 0, 1))
        assert np.array_equal(whole.get(*NAMES), single.get(*NAMES))
        if step == 4:
            saved, whole = whole.save(), array(n)
            assert whole.load(saved) == OK
    one = np.full((3, n), np.nan)
    assert single.values("GetFloat64", sampled_names, one) == OK
    assert np.array_equal(one, np.reshape(single.get(*names), (3, n)))
