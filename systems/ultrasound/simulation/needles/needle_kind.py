"""Kinds of needles, as data."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from sonoservo.systems.files.model_file import model_file
from sonoservo.systems.files.typed_yaml import load_typed, read_yaml
from sonoservo.systems.signals.random_streams import HELD_OUT
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleEchoParameters

NEEDLE = "biopsy"
"""Name of the default kind of needle."""

DRAWN = "drawn"
"""Name for a needle that the seed of a run draws."""

_FAMILIES = (("biopsy", "coated", "echogenic"), ("spinal", "brachytherapy", "echogenic"))
"""Kinds of needles that methods are tuned on, and kinds held out."""

_OTHER_GAUGE, _ROUGHNESS, _CLUTTER = 20, 3.0, (-30.0, -10.0)
"""Gauge of half of the needles; largest difference of the rough level in dB (a plain and a coated
needle are 6 dB apart); and levels of clutter in dB, of the -30 to 0 dB of Lediju et al. (2008)."""


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


def draw_needle(seed: int) -> dict[str, Any]:
    """Draw a scenario's fields: kind of needle, gauge, rough level, and clutter.

    Seeds below 100 draw from the kinds held out, other seeds from those that methods are tuned on.
    """
    rng = np.random.default_rng([seed, 8])
    kind = load_needle(str(rng.choice(_FAMILIES[seed in HELD_OUT])))
    # Only the needle's surface is drawn; all else stays as the scenario has it.
    surface = ("diffuse_db", "diffuse_lobe_deg", "tip", "bevel_deg", "dimples_db")
    echo = {name: value for name, value in asdict(kind.echo).items() if name in surface}
    echo["diffuse_db"] += float(rng.uniform(-_ROUGHNESS, _ROUGHNESS))
    gauge = int(rng.choice([kind.gauge, _OTHER_GAUGE]))
    clutter = float(rng.uniform(*_CLUTTER))
    return {"hand": {"gauge": gauge}, "scanner": {"needle": echo, "clutter_db": clutter}}
