"""Random sequences of calls against the binary: no crash, and every refusal is a clean status.

A refused call says why, and leaves the serialised state as it was, byte by byte.
"""

import ctypes
import math

import numpy as np
import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

OK, ERROR = 0, 3
CALLS_EACH = 25

SPECIAL = [0.0, -0.0, 1.0, -1.0, 1e-300, 1e300, -1e300, math.inf, -math.inf, math.nan, 1e-9]
values = st.one_of(st.sampled_from(SPECIAL), st.floats(-1e4, 1e4), st.floats(1e-12, 1e-2))
references = st.one_of(st.integers(0, 45), st.sampled_from([2**31, 2**32 - 1]))
lists = st.lists(references, max_size=6)
PLAIN = {
    2: ["ExitInitializationMode", "Terminate", "Reset", "EnterInitializationMode", "CancelStep"],
    3: ["ExitInitializationMode", "Terminate", "Reset", "EnterEventMode", "EnterStepMode",
        "EnterContinuousTimeMode", "EnterConfigurationMode", "ExitConfigurationMode",
        "EvaluateDiscreteStates"],
}  # fmt: skip
INTEGERS = ["GetInt64", "SetInt64", "GetUInt64", "SetUInt64"]


def machine(instance) -> type[RuleBasedStateMachine]:
    """State machine that drives instances made by the fixture of that name."""

    class Importer(RuleBasedStateMachine):
        @initialize(
            made=st.sampled_from([(2, 1), (3, 1), ("array", 1), ("array", 4)]),
            started=st.booleans(),
            samples=st.sampled_from([1, 2, 50]),
        )
        def make(self, made, started, samples):
            self.motor = instance(*made)
            self.fmi = self.motor.fmi
            if made[0] == "array":
                assert self.motor.set_sizes(samples=samples) == OK
            # Most of what can go wrong is beyond the start of the life cycle.
            if started:
                self.motor.start(omega_des=700.0)

        def teardown(self):
            self.motor.free()

        def judge(self, call):
            before, said = self.motor.save(), len(self.motor.messages)
            status = call()
            assert status in {OK, ERROR}
            if status == ERROR:
                assert len(self.motor.messages) > said and ": " in self.motor.messages[-1]
                assert self.motor.save() == before
            return status

        @rule(name=st.integers(0, 8))
        def plain(self, name):
            names = PLAIN[self.fmi]
            self.judge(lambda: self.motor.call(names[name % len(names)]))

        @rule(start=values, stop=st.one_of(st.none(), values))
        def initialise(self, start, stop):
            # FMI 2 has two calls for it, the first of which may do its part.
            if self.fmi == 3:
                self.judge(lambda: self.motor.enter_initialization(start, stop))
            else:
                arguments = (0, 0.0, start, int(stop is not None), stop or 0.0)
                self.judge(lambda: self.motor.call("SetupExperiment", *arguments))

        @rule(listed=lists, extra=st.sampled_from([0, 0, 1, 3, 9]), value=values)
        def set_floats(self, listed, extra, value):
            name, extra = ("SetFloat64", extra) if self.fmi == 3 else ("SetReal", 0)
            room = np.full(len(listed) + extra, value)
            self.judge(lambda: self.motor.exchange(name, listed, room))

        @rule(listed=lists, extra=st.sampled_from([0, 0, 1, 3]), value=st.integers(-2, 9),
              name=st.sampled_from(INTEGERS))  # fmt: skip
        def integers(self, listed, extra, value, name):
            room = np.full(len(listed) + extra, value, dtype=np.int64)
            if self.fmi == 3:
                self.judge(lambda: self.motor.exchange(name, listed, room))

        @rule(
            option=st.sampled_from(["closed_loop", "solver", "J", "omega"]),
            value=st.integers(-3, 4),
        )
        def set_option(self, option, value):
            if option in self.motor.variables:
                self.judge(lambda: self.motor.set(**{option: value}))
                self.judge(lambda: self.motor.set(**{option: bool(value)}))

        @rule(wanted=lists, null=st.booleans(), extra=st.sampled_from([0, 0, 9]))
        def get(self, wanted, null, extra):
            extra = extra if self.fmi == 3 else 0
            room = None if null else np.zeros(len(wanted) + extra)
            self.judge(lambda: self.motor.get_status(wanted, room))

        @rule(
            steps=st.sampled_from([0.3, 1.0, 2.0, 7.5]), off=st.sampled_from([0.0, 0.0, 0.4, 3.0])
        )
        def step(self, steps, off):
            # Readable from Initialization Mode on; before that nothing has been stepped.
            room = np.zeros(2)
            known = self.motor.get_status(self.motor.references("step_size", "time"), room) == OK
            h, time_s = room if known else (1e-5, 0.0)
            if self.judge(lambda: self.motor.do_step(time_s + off * h, steps * h)) == OK:
                assert np.isfinite(self.motor.get("theta", "omega", "omega_dot", "i")).all()

        @rule(time_s=values, step_s=st.sampled_from(SPECIAL[3:]))
        def bad_step(self, time_s, step_s):
            if not 0.0 < step_s < 1.0:
                self.judge(lambda: self.motor.do_step(time_s, step_s))

        @rule(at=st.integers(0, 400), value=st.integers(0, 255), cut=st.integers(0, 3),
              sealed=st.booleans())  # fmt: skip
        def load_damaged(self, at, value, cut, sealed):
            content = bytearray(self.motor.save())
            content[at % len(content)] = value
            content = bytes(content[: len(content) - cut])
            if sealed:
                content = self.motor.sealed(content)
            saved = self.motor.save()
            self.judge(lambda: self.motor.load(content))
            self.judge(lambda: self.motor.load(saved))

        @rule()
        def null_pointers(self):
            names = {
                2: ("GetFMUstate", "SetFMUstate", "DeSerializeFMUstate"),
                3: ("GetFMUState", "SetFMUState", "DeserializeFMUState"),
            }
            for name in names[self.fmi]:
                self.judge(lambda name=name: self.motor.call(name, *[ctypes.c_void_p()] * 3))

    return Importer


@pytest.mark.parametrize(
    "examples",
    [pytest.param(0, marks=pytest.mark.long), pytest.param(20_000, marks=pytest.mark.slow)],
)
def test_random_call_sequences(instance, examples):
    how = settings(
        max_examples=examples or 4 * settings().max_examples,
        stateful_step_count=CALLS_EACH,
        phases=[Phase.generate],
    )
    run_state_machine_as_test(machine(instance), settings=how)
