import pytest


@pytest.fixture
def fresh_cache(tmp_path, monkeypatch):
    """A cache of policies and bounds of this test's own."""
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path / "cache"))
