"""Dials of the harder world: what makes images and instruments of a clinic hard."""

from collections.abc import Iterator, Mapping
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
    """One difficulty of reality.

    Parameters
    ----------
    line
        Description for a person, with its unit.
    moderate
        Fields of a scenario of following at moderate strength, by their dotted paths.
    plain
        Numbers of those fields at strength 0, where they are not 0.
    """

    line: str
    moderate: Mapping[str, Any]
    plain: Mapping[str, float] = field(default_factory=dict)

    def changes(self, strength: float = 1.0) -> list[str]:
        """Return the assignments that turn the dial to a strength.

        Numbers change linearly from their value at strength 0 to the moderate one at 1, and beyond.
        Names and switches do not depend on the strength.
        """
        return [f"{path}={self._value(path, strength)}" for path in self.moderate]

    def _value(self, path: str, strength: float) -> Any:
        moderate, off = self.moderate[path], self.plain.get(path, 0.0)
        return off + strength * (moderate - off) if isinstance(moderate, float) else moderate


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
