import json
import os

import numpy as np
import pytest

from sonoservo.systems.files.writing import Unwritten, write_atomically, write_json


def test_a_failure_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = write_atomically(tmp_path / "new" / "file", b"old")

    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupt)
    with pytest.raises(KeyboardInterrupt):
        write_atomically(path, "µ")
    assert path.read_text() == "old"
    assert os.listdir(path.parent) == ["file"]
    monkeypatch.undo()
    assert write_atomically(path, "µ").read_bytes() == "µ".encode()


def test_json_has_numpy_s_numbers_and_null_for_what_is_not_finite(tmp_path):
    data = {"a": np.float64(1.5), "b": np.array([[1, 2]]), 3: (np.nan, -np.inf, "x"), "d": None}
    text = write_json(tmp_path / "file.json", data).read_text()
    assert json.loads(text) == {"a": 1.5, "b": [[1, 2]], "3": [None, None, "x"], "d": None}
    with pytest.raises(TypeError):
        write_json(tmp_path / "file.json", object())


def test_a_link_stays_a_link_and_its_file_is_written(tmp_path):
    target = tmp_path / "folder" / "target"
    target.parent.mkdir()
    (tmp_path / "link").symlink_to(target)
    for text in ("new", "newer"):
        write_atomically(tmp_path / "link", text)
        assert (tmp_path / "link").is_symlink()
        assert target.read_text() == text
    os.link(target, tmp_path / "name")
    write_atomically(target, "newest")
    assert (tmp_path / "name").read_text() == "newest"


def test_pipes_and_devices_are_written_into(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_atomically(pipe, "said")
    assert os.read(reader, 9) == b"said"
    os.close(reader)
    assert pipe.is_fifo()
    number = os.stat("/dev/null").st_rdev
    write_json("/dev/null", [1])
    (tmp_path / "null").symlink_to("/dev/null")
    write_json(tmp_path / "null", [1])
    assert os.stat("/dev/null").st_rdev == number


def test_a_file_keeps_its_permissions(tmp_path):
    path = write_atomically(tmp_path / "file", "old")
    path.chmod(0o600)
    write_atomically(path, "new")
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_full_disk_names_the_file(tmp_path):
    with pytest.raises(OSError, match=r"No space left on device: '/dev/full'"):
        write_atomically("/dev/full", "x")
    unwritten = Unwritten()
    with unwritten.collect():
        write_atomically("/dev/full", "x")
    with unwritten.collect():
        write_atomically(tmp_path / "file" / "..", "x")
    assert unwritten.failure.filename == "/dev/full"
