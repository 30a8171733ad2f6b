"""Random sequences of calls against the binary of the array: no crash, every refusal clean."""

import ctypes
import math

import numpy as np
import pytest
from hypothesis import Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule, run_state_machine_as_test

OK, ERROR = 0, 3
ALL_EXAMPLES, CALLS_EACH = 10_000, 25

SPECIAL = [0.0, -0.0, 1.0, -1.0, 1e300, -1e300, math.inf, math.nan, 1e-9]
values = st.one_of(st.sampled_from(SPECIAL), st.floats(-1e4, 1e4), st.floats(1e-12, 1e-2))
references = st.one_of(st.integers(0, 33), st.sampled_from([2**31, 2**32 - 1]))
counts = st.one_of(st.integers(0, 20), st.just(3))
INTEGERS = ["GetInt64", "SetInt64", "GetUInt64", "SetUInt64"]
PLAIN = ["ExitInitializationMode", "Terminate", "Reset", "EnterConfigurationMode",
         "ExitConfigurationMode", "EnterStepMode", "EnterEventMode"]  # fmt: skip


def machine(array) -> type[RuleBasedStateMachine]:
    """State machine that drives instances made by the fixture of that name."""

    class Importer(RuleBasedStateMachine):
        @initialize(ahead=st.booleans(), samples=st.sampled_from([1, 2, 50]))
        def make(self, ahead, samples):
            self.motors = array(3)
            assert self.motors.set_sizes(samples=samples) == OK
            self.saved = [self.motors.save()]
            if ahead:
                self.motors.start(omega_des=700.0)

        def teardown(self):
            self.motors.free()

        def judge(self, call):
            before, said = self.motors.save(), len(self.motors.messages)
            status = call()
            assert status in {OK, ERROR}
            if status == ERROR:
                assert len(self.motors.messages) > said
                assert ": " in self.motors.messages[-1]
                assert self.motors.save() == before

        @rule(name=st.sampled_from(PLAIN))
        def plain(self, name):
            self.judge(lambda: self.motors.call(name))

        @rule(start=values, stop=st.one_of(st.none(), values))
        def initialise(self, start, stop):
            self.judge(lambda: self.motors.enter_initialization(start, stop))

        @rule(listed=st.lists(references, max_size=4), count=counts, value=values,
              function=st.sampled_from(["GetFloat64", "SetFloat64"]))  # fmt: skip
        def floats(self, listed, count, value, function):
            self.exchange(function, listed, np.full(count, value))

        @rule(listed=st.lists(references, max_size=4), count=counts, value=st.integers(-2, 9),
              function=st.sampled_from(INTEGERS))  # fmt: skip
        def integers(self, listed, count, value, function):
            self.exchange(function, listed, np.full(count, value, dtype=np.int64))

        def exchange(self, function, listed, room):
            array, size = (ctypes.c_uint32 * len(listed))(*listed), ctypes.c_size_t
            pointer = ctypes.c_void_p(room.ctypes.data)
            arguments = (array, size(len(listed)), pointer, size(room.size))
            self.judge(lambda: self.motors.call(function, *arguments))

        @rule(step_s=st.one_of(st.sampled_from([1e-5, 1e-3]), values))
        def step(self, step_s):
            if not step_s > 1e-2:  # longer ones are right, and slow
                time_s = ctypes.c_double()
                reference, one = (ctypes.c_uint32 * 1)(0), ctypes.c_size_t(1)
                self.motors.call("GetFloat64", reference, one, ctypes.byref(time_s), one)
                self.judge(lambda: self.motors.do_step(time_s.value, step_s))

        @rule()
        def save(self):
            self.saved.append(self.motors.save())

        @rule(which=st.integers(0, 9), place=st.integers(0, 5000), byte=st.integers(0, 255))
        def load_with_a_byte_changed(self, which, place, byte):
            content = bytearray(self.saved[which % len(self.saved)])
            content[place % len(content)] = byte
            sealed = self.motors.sealed(bytes(content))
            self.judge(lambda: self.motors.load(sealed))

    return Importer


def fuzz(array, examples: int) -> None:
    run_state_machine_as_test(
        machine(array),
        settings=settings(
            max_examples=examples,
            stateful_step_count=CALLS_EACH,
            phases=[Phase.generate],
        ),
    )


@pytest.mark.long
def test_random_call_sequences(array):
    fuzz(array, 2 * settings().max_examples)


@pytest.mark.slow
def test_ten_thousand_random_call_sequences(array):
    fuzz(array, ALL_EXAMPLES)
