import json
import os

import numpy as np
import pytest

from sonoservo.systems.files.writing import write_atomically, write_json


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


def test_json_has_numpy_s_numbers_and_null_for_what_is_not_finite(tmp_path):
    data = {"a": np.float64(1.5), "b": np.array([[1, 2]]), 3: (np.nan, -np.inf, "x"), "d": None}
    text = write_json(tmp_path / "file.json", data).read_text()
    assert json.loads(text) == {"a": 1.5, "b": [[1, 2]], "3": [None, None, "x"], "d": None}
    with pytest.raises(TypeError):
        write_json(tmp_path / "file.json", object())
