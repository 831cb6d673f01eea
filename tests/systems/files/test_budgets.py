"""Budgets of memory and of YAML, refusals, and claims of folders."""

import pytest

from sonoservo.systems.files.memory import (
    MEMORY_VARIABLE,
    memory_budget,
    require_memory,
    set_memory_budget,
)
from sonoservo.systems.files.refusals import MAX_MESSAGE, ConfigurationError, refusing_failures
from sonoservo.systems.files.typed_yaml import apply_changes, read_yaml
from sonoservo.systems.files.writing import claim_folder
from sonoservo.systems.files.yaml_loader import load_yaml


def test_a_budget_says_how_a_person_raises_it(monkeypatch):
    monkeypatch.delenv(MEMORY_VARIABLE, raising=False)
    require_memory(3.9e9, "a.nrrd", "its voxels")
    with pytest.raises(ConfigurationError, match=r"a\.nrrd: its voxels need 5 GB .*--max-memory"):
        require_memory(5e9, "a.nrrd", "its voxels")
    monkeypatch.setenv(MEMORY_VARIABLE, "6")
    require_memory(5e9, "a.nrrd", "its voxels")


@pytest.mark.parametrize("text", ["much", "0", "nan"])
def test_a_budget_that_is_none_is_refused(monkeypatch, text):
    monkeypatch.setenv(MEMORY_VARIABLE, text)
    with pytest.raises(ConfigurationError, match=f"{MEMORY_VARIABLE}: '{text}' is not allowed"):
        require_memory(1, "a", "its voxels")


def test_a_budget_that_is_set_is_that_of_the_context_alone(monkeypatch):
    monkeypatch.delenv(MEMORY_VARIABLE, raising=False)
    with set_memory_budget(0.5, "--max-memory"):
        assert memory_budget() == 0.5e9
        with set_memory_budget(None, "--max-memory"):
            assert memory_budget() == 0.5e9
    assert memory_budget() == 4e9
    for gigabytes in (0.0, float("nan")):
        with (
            pytest.raises(ConfigurationError, match=f"^--max-memory: {gigabytes} is not allowed"),
            set_memory_budget(gigabytes, "--max-memory"),
        ):
            pass
    assert memory_budget() == 4e9


def test_a_message_is_one_short_printable_line():
    message = str(ConfigurationError(f"a\nb\x1b[31m {'x' * 5000} the end"))
    assert len(message) <= MAX_MESSAGE
    assert message.startswith("a b\N{REPLACEMENT CHARACTER}[31m")
    assert message.endswith("the end")
    words = str(ConfigurationError(" ".join(f"word{n}word" for n in range(200)))).split()
    assert all(each == "..." or each.endswith("word") for each in words)


def test_whatever_fails_inside_names_the_file_and_keeps_its_cause():
    with (
        pytest.raises(ConfigurationError, match=r"^a\.nrrd: damaged: list index") as error,
        refusing_failures("a.nrrd", "damaged"),
    ):
        [][1]
    assert isinstance(error.value.__cause__, IndexError)
    with pytest.raises(ConfigurationError, match="^as it was$"), refusing_failures("a.nrrd"):
        raise ConfigurationError("as it was")
    with pytest.raises(KeyboardInterrupt), refusing_failures("a.nrrd"):
        raise KeyboardInterrupt


def bomb(levels):
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    for n in range(levels):
        lines.append(f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]")
    return "\n".join(lines)


BAD = {
    "brackets": ("a: " + "[" * 400, "nested deeper than 40"),
    "bomb": (bomb(9), "more than 200000 values"),
    "tag": ("a: !!int x", "invalid literal"),
    "twice": ("b: {c: 1}\nd: 2\nb: {e: 3}", "b is given twice in the mapping from line 1 on"),
    "size": ("a: " + "x" * 3_000_000, "3000003 characters"),
    "code": ("a: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
}


@pytest.mark.parametrize("name", BAD)
def test_yaml_beyond_any_scenario_is_one_line(tmp_path, name):
    text, message = BAD[name]
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message) as error:
        read_yaml(path)
    assert str(error.value).startswith(f"{path}: not YAML: ")
    with pytest.raises(ConfigurationError, match=r"^x: .* is not YAML: "):
        apply_changes({}, [f"x={text}"])


def test_honest_aliases_and_depth_are_read():
    assert load_yaml("a: &x [1, 2]\nb: *x\nc: " + "[" * 30 + "]" * 30)["b"] == [1, 2]


def test_a_folder_has_one_writer(tmp_path):
    folder = tmp_path / "out"
    with claim_folder(folder):
        with (
            pytest.raises(ConfigurationError, match="another run is writing here"),
            claim_folder(folder),
        ):
            pass
        (folder / ".log.npz.x.partial").write_text("of a run that was killed")
        (folder / "log.npz").write_text("kept")
    with claim_folder(folder):
        assert [path.name for path in folder.iterdir()] == ["log.npz"]
    with claim_folder(None):
        pass


def test_a_claim_leaves_no_empty_folder_that_it_made(tmp_path):
    (tmp_path / "own").mkdir()
    for folder in (tmp_path / "own" / "a" / "b", tmp_path / "own"):
        with pytest.raises(KeyError), claim_folder(folder):
            raise KeyError
    with claim_folder(tmp_path / "a" / "b"):
        (tmp_path / "a" / "kept").touch()
    assert sorted(tmp_path.rglob("*")) == [tmp_path / each for each in ("a", "a/kept", "own")]
