"""Bounds in the annotations of a dataclass."""

import pkgutil
from contextlib import suppress
from dataclasses import dataclass, field, is_dataclass
from importlib import import_module
from typing import Annotated

import pytest

import sonoservo.diagrams
import sonoservo.systems
from sonoservo.systems.signals.requirements import (
    Bound,
    Bounded,
    Fraction,
    NotNegative,
    Point,
    Positive,
    PositiveInt,
    PositiveTime,
    above,
    annotations_of,
    at_least,
    between,
    check_bounds,
    one_of,
)


@dataclass(kw_only=True)
class Needle(Bounded):
    radius: Positive = 1e-3
    tremor: NotNegative = 0.0
    echo: Fraction = 0.5
    passes: PositiveInt = 1
    start: PositiveTime | None = None
    entry: Point | None = None
    depths: list[Positive] = field(default_factory=list)
    dip_deg: Annotated[float, between(-90, 90, " deg")] = 0.0
    gauge: Annotated[int, at_least(7)] = 18
    kind: Annotated[str, one_of("straight", "bevelled")] = "straight"


@dataclass(kw_only=True, slots=True)
class Bevelled(Needle):
    bevel: Annotated[float, above(1)] = 2.0

    def __post_init__(self):
        check_bounds(self)


@pytest.mark.parametrize("schema", [Needle, Bevelled])
def test_values_within_their_bounds_are_accepted(schema):
    schema(tremor=0, echo=1, start=3.0, entry=[0, 0, 0], depths=[0.1], kind="bevelled")


@pytest.mark.parametrize("schema", [Needle, Bevelled])
@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"radius": 0.0}, "radius: 0.0 is not allowed; it must be a number above 0"),
        ({"radius": float("nan")}, "radius: nan is not allowed"),
        ({"radius": "thick"}, "radius: 'thick' is not allowed"),
        ({"tremor": -1}, "tremor: -1 is not allowed; it must be a number of at least 0"),
        ({"echo": 1.5}, "echo: 1.5 is not allowed; it must be from 0 to 1"),
        ({"passes": 0}, "passes: 0 is not allowed; it must be a number of at least 1"),
        ({"start": 2e6}, r"start: 2000000.0 is not allowed; .* above 0 and at most 1e\+06 s"),
        ({"entry": [0, 1]}, r"entry: \[0, 1\] is not allowed; it must be three coordinates"),
        ({"depths": [0.1, 0.0]}, "depths.1: 0.0 is not allowed"),
        ({"dip_deg": 90}, "dip_deg: 90 is not allowed; it must be between -90 and 90 deg"),
        ({"gauge": 6}, "gauge: 6 is not allowed; it must be a number of at least 7"),
        ({"kind": "bent"}, "kind: 'bent' is not allowed; it must be 'straight' or 'bevelled'"),
    ],
)
def test_a_value_out_of_bounds_is_named_with_what_is_allowed(schema, changes, message):
    with pytest.raises(ValueError, match=message):
        schema(**changes)


def dataclasses_of_the_house():
    for root in (sonoservo.systems, sonoservo.diagrams):
        for module in pkgutil.walk_packages(root.__path__, f"{root.__name__}."):
            if module.name.endswith("__main__"):
                continue
            with suppress(ModuleNotFoundError):  # of an extra
                for value in vars(import_module(module.name)).values():
                    if is_dataclass(value) and getattr(value, "__module__", "") == module.name:
                        yield value


def bounded_fields(schema):
    """Names of the fields that have a bound themselves."""
    found = annotations_of(schema, Bound)
    return list({name: None for name, _, of_elements, _ in found if not of_elements})


def test_every_bound_in_the_house_is_checked():
    count = 0
    for schema in filter(bounded_fields, dataclasses_of_the_house()):
        with suppress(TypeError):  # a value without defaults; those have tests of their own
            schema()
            for name in bounded_fields(schema):
                with pytest.raises(ValueError, match=rf"^{name}: nan is not allowed"):
                    schema(**{name: float("nan")})
                count += 1
    assert count > 200
