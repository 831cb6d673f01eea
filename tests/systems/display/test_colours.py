from importlib.resources import files
from itertools import combinations

import numpy as np
import pytest
from skimage.color import rgb2lab

from sonoservo.systems.display.colours import (
    FORCE,
    HUB,
    MODE_COLOURS,
    SECTOR,
    STOPPED,
    TRUTH,
    UNCERTAINTY,
    ink,
)
from sonoservo.systems.signals import TrackingMode
from sonoservo.systems.signals.needle_colours import LINE_COLOURS

# How a colour without its blue, green or red cones is seen, in linear RGB: Machado, Oliveira and
# Fernandes 2009, table 1, severity 1.
VISION = {
    "normal": np.eye(3).ravel(),
    "protanopia": [0.152286, 1.052583, -0.204868, 0.114503, 0.786281, 0.099216,
                   -0.003882, -0.048116, 1.051998],
    "deuteranopia": [0.367322, 0.860646, -0.227968, 0.280085, 0.672501, 0.047413,
                     -0.011820, 0.042940, 0.968881],
    "tritanopia": [1.255528, -0.076749, -0.178779, -0.078411, 0.930809, 0.147602,
                   0.004733, 0.691367, 0.303900],
}  # fmt: skip


def seen(colour, vision):
    """CIE L*a*b* of an sRGB colour as somebody sees it."""
    c = np.array(colour)
    linear = np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.reshape(VISION[vision], (3, 3)) @ linear, 0, 1)
    c = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return rgb2lab(c.reshape(1, 1, 3)).ravel()


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize(
    "colours",
    [
        list(MODE_COLOURS.values()),  # which the tracker is in
        [*list(MODE_COLOURS.values())[1:], TRUTH, UNCERTAINTY],  # lie on one another
        [FORCE, HUB, SECTOR],
        [FORCE, TRUTH, MODE_COLOURS[TrackingMode.TRACKING]],
    ],
)
def test_colours_are_told_apart_by_every_colour_vision(vision, colours):
    for first, second in combinations(colours, 2):
        # 20 is ten times what is just noticed side by side.
        assert np.linalg.norm(seen(first, vision) - seen(second, vision)) > 20


def test_the_key_s_colours_are_those_of_the_lines():
    css = files("sonoservo.systems.display.console").joinpath("console.css").read_text()
    for name, marked in (("resting", "first"), ("riding", "second"), ("appeared", "third")):
        assert f".{marked} {{ color: {LINE_COLOURS[name]}; }}" in css


def test_ink_reads_on_every_mode_s_ground():
    for colour in (*MODE_COLOURS.values(), STOPPED):
        lightness = [rgb2lab(np.reshape(c, (1, 1, 3)))[0, 0, 0] for c in (ink(colour), colour)]
        assert abs(lightness[0] - lightness[1]) > 40
