"""Compiling in a second process, while the first one trains."""

import pytest

from cosim.simulation import ahead


@pytest.fixture
def cold(monkeypatch):
    monkeypatch.setattr(ahead, "is_compiled", lambda _: False)
    monkeypatch.setattr(ahead, "workers", lambda _: 2)


@pytest.mark.long
def test_a_second_process_compiles(cold):
    with ahead.compiling_ahead(2) as child:
        assert child is not None
        assert child.wait(300) == 0


def test_an_error_ends_the_second_process(cold):
    with pytest.raises(KeyboardInterrupt), ahead.compiling_ahead(2) as child:
        raise KeyboardInterrupt
    assert child is not None
    assert child.wait(60) != 0


def test_nothing_is_started_for_kernels_that_are_there(cold, monkeypatch):
    monkeypatch.setattr(ahead, "is_compiled", lambda _: True)
    with ahead.compiling_ahead(2) as child:
        assert child is None
