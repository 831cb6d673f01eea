"""Stores of files: folders, and what fsspec reaches."""

import pytest

from sonoservo.diagrams.studies import Store


@pytest.fixture(params=["folder", "file", "memory"])
def store(request, tmp_path):
    folder = tmp_path / "s"
    urls = {"folder": str(folder), "file": folder.as_uri(), "memory": f"memory:/{tmp_path}/"}
    return Store(urls[request.param])


def test_what_is_written_is_there(store):
    assert store.sizes() == {}
    assert store.read("a/b.bin") is None
    store.write({"a/b.bin": b"123", "c": b""})
    store.write({"a/b.bin": b"12345"})
    assert store.sizes() == {"a/b.bin": 5, "c": 0}
    assert store.read("a/b.bin") == b"12345"
    store.remove(["c"])
    assert store.sizes() == {"a/b.bin": 5}


def test_a_reader_sees_a_whole_file_or_none(tmp_path):
    """A file of fsspec appears when all of a case's files are complete."""
    store = Store(f"memory:/{tmp_path}")

    with pytest.raises(TypeError):
        store.write({"whole": b"1", "broken": None})
    assert store.sizes() == {}
