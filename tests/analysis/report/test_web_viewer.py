"""The web viewer's files: whole, from the installed package, and fetched once."""

import pytest
import rerun_cli

from analysis.report.web_viewer import FILES, WebViewerError, web_viewer_files


def test_files_are_fetched_whole_and_once(monkeypatch, tmp_path):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    script, wasm = web_viewer_files()
    assert (script.name, wasm.name) == FILES
    assert "wasm_bindgen" in script.read_text(encoding="utf-8")
    content = wasm.read_bytes()
    assert content.startswith(b"\0asm")
    assert len(content) > 10_000_000
    assert wasm.is_relative_to(tmp_path)
    sums = {file.with_name(file.name + ".sha256") for file in (script, wasm)}
    assert set(script.parent.iterdir()) == {script, wasm, *sums}

    # What is there needs no program any more.
    monkeypatch.setattr(rerun_cli, "__file__", str(tmp_path / "gone" / "__init__.py"))
    assert web_viewer_files() == [script, wasm]
    wasm.write_bytes(content[:-1])
    with pytest.raises(WebViewerError, match=r"gone/rerun: .*install rerun-sdk again"):
        web_viewer_files()


def test_program_that_serves_nothing_is_refused(monkeypatch, tmp_path):
    monkeypatch.setenv("MINIROBOTS_CACHE", str(tmp_path))
    program = tmp_path / "rerun"
    program.write_text("#!/bin/sh\nexit 0\n")
    program.chmod(0o755)
    monkeypatch.setattr(rerun_cli, "__file__", str(tmp_path / "__init__.py"))
    with pytest.raises(WebViewerError, match="does not serve"):
        web_viewer_files()
    assert not list(tmp_path.rglob("*.wasm"))
