"""Lines of text and scales in mm, as white pictures on a transparent background."""

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

PIXELS = 1000
"""Pixels of a text or a scale per unit of length on the screen."""


def line_image(text: str, height: int) -> NDArray[np.uint8]:
    """Return a line of text as a (rows, columns, 2) picture; rows depend on `height` alone."""
    return _white(np.concatenate([_letter(each, height) for each in text], axis=1))


@cache
def _letter(letter: str, height: int) -> NDArray[np.uint8]:
    """Return a letter's (rows, columns) opacity; cached, since most new texts use old letters."""
    font = _font(height)
    image = Image.new("L", (round(font.getlength(letter)), int(np.ceil(1.25 * height))))
    ImageDraw.Draw(image).text((0, height), letter, 255, font, "ls")
    return np.asarray(image)


def scale_image(
    low: float, high: float, step: float, length: float, *, upright: bool
) -> NDArray[np.uint8]:
    """Return a scale with a tick at every multiple of a step, and numbers in mm.

    Parameters
    ----------
    low, high, step
        Ends and step of the scale, in m.
    length
        Length from `low` to `high` on the screen.
    upright
        Whether the scale stands to the left of a picture, with `low` at the top, or lies below it.

    Returns
    -------
    (rows, columns, 2) picture, longer than the scale by the same margin at both ends.
    """
    letters, margin, breadth = round(0.024 * PIXELS), round(0.03 * PIXELS), 0.055 * PIXELS
    pixels = round(length * PIXELS)
    size = (pixels + 2 * margin, round(breadth))
    image = Image.new("L", size[::-1] if upright else size)
    draw = ImageDraw.Draw(image)
    font = _font(letters)
    tick = round(0.010 * PIXELS)
    for number in range(int(np.ceil(low / step - 1e-6)), int(np.floor(high / step + 1e-6)) + 1):
        at = margin + (number * step - low) / (high - low) * pixels
        label = f"{1e3 * number * step:g}"
        if upright:
            draw.line([(size[1] - tick, at), (size[1], at)], 255, 2)
            draw.text((size[1] - 1.5 * tick, at), label, 255, font, "rm")
        else:
            draw.line([(at, 0), (at, tick)], 255, 2)
            draw.text((at, 1.5 * tick), label, 255, font, "mt")
    return _white(np.asarray(image))


@cache
def _font(height: int) -> Any:
    return ImageFont.load_default(size=height)


def _white(opacity: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a white picture with an opacity; its material gives it a colour."""
    return np.stack([np.full_like(opacity, 255), opacity], axis=-1)
