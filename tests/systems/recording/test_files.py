import os

import pytest

from sonoservo.systems.recording.files import write_atomically


def test_writes_text_and_bytes_into_a_new_folder(tmp_path):
    path = tmp_path / "new" / "file"
    assert write_atomically(path, "µ").read_bytes() == "µ".encode()
    assert write_atomically(path, b"\x00").read_bytes() == b"\x00"
    assert os.listdir(path.parent) == ["file"]


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = write_atomically(tmp_path / "file", "old")

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, "new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["file"]
