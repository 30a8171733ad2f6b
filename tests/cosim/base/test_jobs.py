"""How long jobs may begin."""

import pytest

from cosim.base import jobs


@pytest.mark.parametrize("minutes", [0.5, 3.0])
def test_a_budget_is_of_minutes(minutes, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(jobs.time, "monotonic", lambda: now[0])
    begins, always = jobs.until(minutes), jobs.until(None)
    for share, expected in ((0.0, True), (0.99, True), (1.01, False)):
        now[0] = 100.0 + 60.0 * minutes * share
        assert (begins(), always()) == (expected, True)
