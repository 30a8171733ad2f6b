"""Messages reach the importer while it wants them, and only then."""

import ctypes

import pytest
from fmpy.fmi3 import fmi3LogMessageCallback

OK, ERROR = 0, 3
CATEGORY = "logStatusError"


def provoke(motor) -> int:
    """Messages that a refused call brings."""
    before = len(motor.messages)
    assert motor.set(J=-1.0) == ERROR
    return len(motor.messages) - before


def test_logging_is_as_instantiated(instance, kind):
    assert provoke(instance(kind, logging=True)) == 1
    assert provoke(instance(kind, logging=False)) == 0


def test_logging_is_switched_on_and_off(instance, kind):
    motor = instance(kind, logging=False)
    for categories in ((), (CATEGORY,), (CATEGORY, CATEGORY)):
        assert motor.set_logging(True, *categories) == OK
        assert provoke(motor) == 1
        assert motor.call("Reset") == OK
        assert provoke(motor) == 1
        assert motor.set_logging(False, *categories) == OK
        assert provoke(motor) == 0


@pytest.mark.parametrize("logging", [False, True])
@pytest.mark.parametrize("category", ["logAll", "", None])
def test_unknown_categories_are_refused_and_change_nothing(instance, kind, logging, category):
    motor = instance(kind, logging=logging)
    for on in (False, True):
        assert motor.set_logging(on, CATEGORY, category) == ERROR
        assert provoke(motor) == logging
    if logging:
        assert f'no log category "{category or ""}"; use {CATEGORY}' in motor.messages[0]


@pytest.mark.parametrize("logging", [False, True])
def test_a_refused_instantiation_is_logged_if_wanted(instance, kind, logging):
    motor = instance(kind, token="{other}", logging=logging)
    assert not motor.handle
    assert len(motor.messages) == logging


@pytest.mark.parametrize("logging", [False, True])
@pytest.mark.parametrize("interface", ["ModelExchange", "ScheduledExecution"])
def test_what_is_not_offered_is_logged_if_wanted(library, token, interface, logging):
    messages: list[bytes] = []
    log = fmi3LogMessageCallback(lambda *a: messages.append(a[3]))
    make = getattr(ctypes.CDLL(str(library)), f"fmi3Instantiate{interface}")
    none = ctypes.c_void_p()
    flags = [ctypes.c_bool(False), ctypes.c_bool(logging)]
    assert not make(b"name", token.encode(), b"", *flags, none, log, none, none, none)
    assert len(messages) == logging
