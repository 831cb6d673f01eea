"""Colours of the displays, as red, green and blue from 0 to 1.

They follow Okabe and Ito's palette, which stays distinguishable under every kind of colour vision;
a test checks this. The modes differ in lightness too. What is tracked has the colour of estimates.
"""

from collections.abc import Sequence

from PIL import ImageColor
from pydrake.geometry import Rgba

from sonoservo.systems.signals import needle_colours
from sonoservo.systems.signals.needle_estimate import TrackingMode

TRUTH, ESTIMATE = (
    tuple(each / 255 for each in ImageColor.getrgb(colour))
    for colour in (needle_colours.TRUTH, needle_colours.ESTIMATE)
)
STEEL = (0.62, 0.65, 0.70)
HUB = (0.78, 0.30, 0.55)
SECTOR = (0.0, 0.35, 0.65)
UNCERTAINTY = (0.70, 0.0, 1.0)
FORCE = (0.80, 0.95, 0.50)
CROSS_SECTION = (0.92, 0.94, 0.96)
STOPPED = (0.80, 0.35, 0.65)

MODE_COLOURS = {
    TrackingMode.SEARCHING: (0.52, 0.54, 0.60),
    TrackingMode.TRACKING: ESTIMATE,
    TrackingMode.COASTING: (1.00, 0.94, 0.63),
    TrackingMode.LOST: (0.86, 0.16, 0.12),
}


def rgba(colour: Sequence[float], opacity: float = 1.0) -> Rgba:
    """Return a colour as Drake's `Rgba`."""
    return Rgba(*colour, opacity)


def ink(background: Sequence[float]) -> tuple[float, float, float]:
    """Return black or white, whichever reads better on a background."""
    light = 0.21 * background[0] + 0.72 * background[1] + 0.07 * background[2]
    return (0.0, 0.0, 0.0) if light > 0.5 else (1.0, 1.0, 1.0)


def hexadecimal(colour: Sequence[float]) -> str:
    """Return a colour as a web page writes it."""
    return "#" + "".join(f"{round(255 * each):02x}" for each in colour)
