"""Kinds of needles, as data."""

from dataclasses import dataclass, field

from sonoservo.systems.files.model_file import model_file
from sonoservo.systems.files.typed_yaml import load_typed, read_yaml
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleEchoParameters

NEEDLE = "biopsy"
"""Name of the default kind of needle."""


@dataclass(kw_only=True)
class NeedleKind:
    """A kind of needle.

    Parameters
    ----------
    gauge
        Gauge, which sets the diameter.
    echo
        Parameters of its echo.
    """

    gauge: int = 18
    echo: NeedleEchoParameters = field(default_factory=NeedleEchoParameters)


def load_needle(name: str) -> NeedleKind:
    """Read a kind of needle.

    Parameters
    ----------
    name
        Name of a file in ``models/needles`` ("biopsy"), or a path.
    """
    path = model_file("needles", name)
    return load_typed(NeedleKind, read_yaml(path), str(path))
