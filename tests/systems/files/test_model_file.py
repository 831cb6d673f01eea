"""Model files that are read once."""

import os

import pytest

from sonoservo.systems.files.model_file import model_file, read_once


@pytest.fixture
def reader():
    @read_once
    def read(path):
        return [path, path.read_text()]

    return read


def test_a_file_is_read_again_only_after_a_change(tmp_path, reader):
    path = tmp_path / "model.yaml"
    path.write_text("mass: 1")
    first = reader(path)
    assert reader(path) is first
    path.write_text("mass: 22")
    assert reader(path)[1] == "mass: 22"
    path.write_text("mass: 33")
    os.utime(path, ns=(0, 0))
    assert reader(path)[1] == "mass: 33"


def test_one_relative_path_in_two_folders_is_two_files(tmp_path, reader, monkeypatch):
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "model.yaml").write_text(name)
        os.utime(folder / "model.yaml", ns=(0, 0))
        monkeypatch.chdir(folder)
        path, content = reader((folder / "model.yaml").relative_to(folder))
        assert (str(path), content) == ("model.yaml", name)


def test_failures_are_not_remembered(tmp_path, reader):
    path = tmp_path / "model.yaml"
    with pytest.raises(FileNotFoundError):
        reader(path)
    path.write_text("there now")
    assert reader(path)[1] == "there now"


def test_a_model_in_json_is_itself_and_no_file_beside_it(tmp_path):
    own = tmp_path / "probe.json"
    for name in ("probe.json", "probe.yaml"):
        (tmp_path / name).write_text("{}")
    assert model_file("probes", str(own)) == own
