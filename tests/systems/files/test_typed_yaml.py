from dataclasses import dataclass, field

import numpy as np
import pytest

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import apply_changes, load_typed, read_yaml
from sonoservo.systems.signals import require_positive


@dataclass(kw_only=True)
class Wheel:
    radius: float = 0.3
    spokes: int = 32

    def __post_init__(self):
        require_positive(radius=self.radius)


@dataclass(kw_only=True)
class Bicycle:
    name: str = "roadster"
    front: Wheel = field(default_factory=Wheel)
    spares: list[Wheel] = field(default_factory=list)
    gears: list[float] = field(default_factory=lambda: [1.0])
    bell: bool = True
    basket: float | None = None
    min_tread: float = 1e-3


@dataclass(kw_only=True)
class Tandem:
    trailer: Wheel | None = None
    wheels: list[Wheel] = field(default_factory=lambda: [Wheel()])


@dataclass(kw_only=True)
class Lock:
    kind: str = "lock"
    keys: int = 2


@dataclass(kw_only=True)
class Chain:
    kind: str = "chain"
    length: float = 1.0

    def __post_init__(self):
        require_positive(length=self.length)


@dataclass(kw_only=True)
class Stand:
    guard: Lock | Chain = field(default_factory=Lock)
    tether: Lock | Chain = field(default_factory=Chain)
    more: list[Lock | Chain] = field(default_factory=list)


def test_a_hint_names_a_section_that_is_in_use():
    with pytest.raises(ConfigurationError, match=r"did you mean 'wheels\.0\.spokes'"):
        load_typed(Tandem, {"spokes": 3}, "x")
    with pytest.raises(ConfigurationError, match=r"did you mean 'trailer\.spokes'"):
        load_typed(Tandem, {"trailer": {"radius": 0.3}, "spokes": 3}, "x")


def test_loads_over_defaults():
    bicycle = load_typed(
        Bicycle, {"front": {"radius": "3e-1"}, "spares": [{"spokes": 36}], "basket": 2}, "x"
    )
    assert bicycle == Bicycle(front=Wheel(radius=0.3), spares=[Wheel(spokes=36)], basket=2.0)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"front": {"spoke": 3}}, "front.spoke: unknown field; did you mean 'spokes'?"),
        ({"zzz": 3}, "zzz: unknown field; known: basket, bell"),
        ({"spokes": 3}, ": spokes: unknown field; did you mean 'front.spokes'?"),
        ({"radios": 3}, ": radios: unknown field; did you mean 'front.radius'?"),
        (
            {"front": 3},
            "front: 3 is not allowed; expected a mapping with the fields radius, spokes",
        ),
        ({"front": {"radius": "abc"}}, "radius: 'abc' is not allowed; expected a finite number"),
        ({"front": {"spokes": 1.5}}, "front.spokes: 1.5 is not allowed; expected a whole number"),
        ({"front": {"radius": float("nan")}}, "front.radius: nan is not allowed"),
        ({"spares": [{}, {"radius": 0}]}, "spares.1.radius: 0.0 is not allowed"),
        ({"bell": "yes"}, "bell: 'yes' is not allowed; expected true or false"),
        ({"name": None}, "name: it has no value; expected text"),
    ],
)
def test_mistakes_are_named_by_their_path(data, message):
    with pytest.raises(ConfigurationError) as error:
        load_typed(Bicycle, data, "my bicycle")
    assert str(error.value).startswith("my bicycle: ")
    assert message in str(error.value)


@pytest.mark.parametrize(
    "changes",
    [
        ["front.radius=0.4", "spares.0.spokes=24", "gears=[1, 2.5]"],
        {"front.radius": 0.4, "spares.0.spokes": np.int64(24), "gears": np.array([1, 2.5])},
    ],
)
def test_changes_reach_nested_fields_and_list_items(changes):
    data = {"spares": [{"spokes": 1}]}
    apply_changes(data, changes)
    apply_changes(data, None)
    assert data == {"spares": [{"spokes": 24}], "front": {"radius": 0.4}, "gears": [1, 2.5]}


@pytest.mark.parametrize("text", ["no equals", "size.deeper=3", "spares.7.spokes=1", "gears=[1"])
def test_bad_assignments_are_refused(text):
    with pytest.raises(ConfigurationError):
        apply_changes({"size": 1, "spares": []}, [text])


@pytest.mark.parametrize("changes", ["front.radius=0.4", 3])
def test_changes_of_another_form_say_what_is_expected(changes):
    with pytest.raises(ConfigurationError, match=r"of type (str|int); expected a mapping such as"):
        apply_changes({}, changes)


@pytest.mark.parametrize("content", ["- 1", "{a: 1", "\xff\xfe", None])
def test_files_without_a_mapping_are_refused(tmp_path, content):
    path = tmp_path / "file.yaml"
    if content is not None:
        path.write_bytes(content.encode("latin-1"))
    with pytest.raises(ConfigurationError, match=r"file\.yaml: "):
        read_yaml(path)


@pytest.mark.parametrize(
    ("changes", "guard"),
    [
        ([], Lock()),
        (["guard.keys=3"], Lock(keys=3)),
        (["guard=chain"], Chain()),
        (["guard=chain", "guard.length=2"], Chain(length=2.0)),
        (["guard.length=2", "guard.kind=chain"], Chain(length=2.0)),
        (["guard.keys=3", "guard=chain"], Chain()),
    ],
)
def test_a_kind_chooses_among_dataclasses(changes, guard):
    data = {}
    apply_changes(data, changes)
    assert load_typed(Stand, data, "x").guard == guard


def test_kinds_may_be_listed_and_a_default_may_choose():
    stand = load_typed(Stand, {"more": ["chain", {"keys": 1}, {"kind": "lock"}]}, "x")
    assert stand.more == [Chain(), Lock(keys=1), Lock()]
    assert load_typed(Stand, {"tether": {"length": 2.0}}, "x").tether == Chain(length=2.0)
    assert load_typed(Stand, {"tether": {"kind": "lock"}}, "x").tether == Lock()


@pytest.mark.parametrize(
    ("guard", "message"),
    [
        ("chian", "x: guard: unknown kind 'chian'; did you mean 'chain'?"),
        (3, "x: guard: 3 is not allowed; expected one of lock, chain, or a mapping"),
        ({"length": 1}, "x: guard.length: unknown field; known: keys, kind"),
        (None, "x: guard: it has no value; expected one of"),
    ],
)
def test_a_wrong_kind_is_one_clear_line(guard, message):
    with pytest.raises(ConfigurationError) as error:
        load_typed(Stand, {"guard": guard}, "x")
    assert message in str(error.value)
