"""The code that a result depends on."""

from cosim.sources import ROOT, imported_files, source_digest, with_imports


def test_imports_are_followed():
    files = with_imports([ROOT / "cosim" / "episode.py"])
    names = {file.name for file in files}
    assert {"episode.py", "master.py", "params.py", "errors.py"} <= names
    assert not {"run.py", "recording.py", "policy.py"} & names
    assert ROOT / "cosim" / "master.py" in imported_files(ROOT / "cosim" / "episode.py")


def test_digest_follows_contents_and_texts(tmp_path):
    file = tmp_path / "a.py"
    file.write_text("x = 1\n")
    first = source_digest([file])
    assert source_digest([file]) == first
    assert source_digest([file], "2.0") != first
    file.write_text("x = 2\n")
    assert source_digest([file]) != first
