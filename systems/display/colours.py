"""Colours of the displays, as red, green and blue from 0 to 1.

They follow Okabe and Ito's palette, which stays distinguishable under every kind of colour vision;
a test checks this. The modes differ in lightness too.
"""

from collections.abc import Sequence

from pydrake.geometry import Rgba

from sonoservo.systems.signals.needle_estimate import TrackingMode

STEEL = (0.62, 0.65, 0.70)
HUB = (0.78, 0.30, 0.55)
SECTOR = (0.0, 0.35, 0.65)
UNCERTAINTY = (0.70, 0.0, 1.0)
FORCE = (0.95, 0.65, 0.0)
CROSS_SECTION = (0.25, 0.60, 0.95)
STOPPED = (0.80, 0.35, 0.65)

MODE_COLOURS = {
    TrackingMode.SEARCHING: (0.52, 0.54, 0.60),
    TrackingMode.TRACKING: (0.05, 0.68, 0.47),
    TrackingMode.COASTING: (1.00, 0.75, 0.10),
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
