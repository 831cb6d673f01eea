"""Dials of the harder world: difficulties of a clinic's images and instruments."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sonoservo.systems.files.typed_yaml import read_yaml

if TYPE_CHECKING:
    import numpy as np

_WEAKEST = 0.1  # smallest strength of a dial that is on


@dataclass(frozen=True)
class Dial:
    """One difficulty of reality."""

    line: str  # description for a person, with its unit
    moderate: Mapping[str, Any]  # fields of a scenario of following at moderate strength, by path
    plain: Mapping[str, float] = field(default_factory=dict)  # at strength 0, if not 0
    strengths: Sequence[float] = (0.5, 1.0, 2.0)  # studied; none: closed loop only
    value: float = 1.0  # quantity at moderate strength, in its own unit
    at_zero: float = 0.0  # quantity at strength 0
    unit: str = ""  # in words; empty for a switch
    inverse: bool = False  # the quantity falls with the strength, as a distance does
    judged: Sequence[str] = ()  # how errors are judged in a study: "in_probe", "across_depth"
    phantom_field: Mapping[str, Sequence[float]] = field(default_factory=dict)

    def changes(self, strength: float = 1.0) -> list[str]:
        """Return the assignments that turn the dial to a strength.

        Numbers change linearly from their value at strength 0 to the moderate one at 1, and beyond.
        Names and switches do not depend on the strength.
        """
        return [f"{path}={self._value(path, strength)}" for path in self.moderate]

    def _value(self, path: str, strength: float) -> Any:
        moderate, off = self.moderate[path], self.plain.get(path, 0.0)
        return off + strength * (moderate - off) if isinstance(moderate, float) else moderate

    def quantity(self, strength: float) -> float:
        """Return the dial's quantity at a strength, in its own unit."""
        if self.inverse:
            return self.value / strength
        return self.at_zero + strength * (self.value - self.at_zero)

    def words(self, strength: float, unit: bool = True) -> str:
        """Return that quantity as text, with its unit or without; a switch is "on"."""
        if not self.unit:
            return "on"
        return f"{self.quantity(strength):.3g}{f' {self.unit}' if unit else ''}"

    def phantom_changes(self, strength: float) -> dict[str, float]:
        """Return the changes of the phantom's file, where the dial is in it."""
        fields = self.phantom_field.items()
        return {path: a + b * self.quantity(strength) for path, (a, b) in fields}


def load_dials() -> dict[str, Dial]:
    """Return all dials by name."""
    path = Path(str(files("sonoservo.diagrams"))) / "dials.yaml"
    return {name: Dial(**each) for name, each in read_yaml(path).items()}


def draw_dials_on(rng: "np.random.Generator") -> Iterator[tuple[str, Dial, float]]:
    """Draw which dials are on, half of all in random order, with strengths from 0.1 to 1."""
    dials = load_dials()
    for name in rng.permutation(sorted(dials)):
        on, strength = rng.random() < 0.5, float(rng.uniform(_WEAKEST, 1))
        if on:
            yield str(name), dials[name], strength
