"""Random draws of the dials of the harder world for a data set."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sonoservo.diagrams.dials import load_dials

_SEEN = (
    "phantom",
    "phantom_motion.",
    "scanner.air_pockets.",
    "scanner.motor.",
    "scanner.needle.",
    "tissue_reaction.",
)
"""Beginnings of the fields that show in the volumes of a probe held still."""

_DIP, _SPEED = "hand.dip_deg", "hand.pushes.0.speed"

_WEAKEST = 0.1
"""Smallest strength of a dial that is on."""


@dataclass(frozen=True)
class DrawnDials:
    """Dials of one sequence.

    Parameters
    ----------
    strengths
        Strength of each dial that is on, relative to the moderate one.
    changes
        Assignments that turn the dials in a scenario.
    max_dip_deg, max_speed
        Upper limits of the needle's angle below the horizontal in deg, and of its speed in m/s.
    """

    strengths: Mapping[str, float] = field(default_factory=dict)
    changes: tuple[str, ...] = ()
    max_dip_deg: float = 30.0
    max_speed: float = 12e-3


def draw_dials(rng: np.random.Generator) -> DrawnDials:
    """Draw which dials are on, and how far.

    Each dial of `load_dials` that shows in a volume is on in half of the sequences, with a strength
    from 0.1 to 1. Of dials that set the same field, at most one is on. The needle's angle and speed
    are drawn anyway; their dials raise the upper limits.
    """
    dials = load_dials()
    strengths: dict[str, float] = {}
    changes: list[str] = []
    taken: set[str] = set()
    limits = {_DIP: DrawnDials.max_dip_deg, _SPEED: DrawnDials.max_speed}
    for name in rng.permutation(sorted(dials)):
        dial, on, strength = dials[name], rng.random() < 0.5, rng.uniform(_WEAKEST, 1)
        raised = [path for path in dial.moderate if path in limits]
        if not on or taken & dial.moderate.keys():
            continue
        if raised:
            for path in raised:
                limits[path] = max(limits[path], strength * dial.moderate[path])
        elif all(path.startswith(_SEEN) for path in dial.moderate):
            taken |= dial.moderate.keys()
            changes += dial.changes(strength)
        else:
            continue
        strengths[str(name)] = strength
    return DrawnDials(strengths, tuple(changes), limits[_DIP], limits[_SPEED])
