"""Legend of the colours and shapes in a view."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from sonoservo.systems.display.colours import (
    HUB,
    PANEL,
)
from sonoservo.systems.display.textured_quads import bytes_of, draw_picture

Entry = tuple[str, str, Sequence[float]]
"""Text, shape of its mark (line, needle, ellipse or arrow) and colour of the mark."""

_ROW, _TEXT, _SWATCH, _COLUMN = 44, 30, 64, 370  # pixels


def legend_image(columns: Sequence[Sequence[Entry]]) -> NDArray[np.uint8]:
    """Return a legend, given its columns of entries, as a (rows, columns, 4) picture."""
    size = (_COLUMN * len(columns), _ROW * max(map(len, columns)) + 16)
    image = Image.new("RGBA", size, bytes_of((0.93, 0.93, 0.93)))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size=_TEXT)
    for column, entries in enumerate(columns):
        for row, (text, shape, colour) in enumerate(entries):
            x, y = 12 + _COLUMN * column, 8 + _ROW * (row + 0.5)
            _draw_swatch(draw, shape, x, y, bytes_of(colour))
            draw.text((x + _SWATCH + 12, y), text, font=font, fill=bytes_of(PANEL), anchor="lm")
    return np.array(image)


def _draw_swatch(
    draw: ImageDraw.ImageDraw, shape: str, x: float, y: float, fill: tuple[int, ...]
) -> None:
    end = x + _SWATCH
    if shape == "ellipse":
        draw.ellipse((x + 8, y - 9, end - 8, y + 9), fill=fill)
    elif shape == "arrow":
        draw.rectangle((x, y - 4, end - 20, y + 4), fill=fill)
        draw.polygon([(end - 24, y - 12), (end, y), (end - 24, y + 12)], fill=fill)
    else:
        draw.rectangle((x, y - 5, end, y + 5), fill=fill)
    if shape == "needle":
        draw.rectangle((x, y - 9, x + 18, y + 9), fill=bytes_of(HUB))


def draw_legend(
    meshcat: Meshcat,
    path: str,
    X_WL: RigidTransform,
    width: float,
    columns: Sequence[Sequence[Entry]],
) -> None:
    """Draw a legend.

    Parameters
    ----------
    meshcat, path
        Meshcat to draw in, and the path of the drawing.
    X_WL
        Pose of the middle of the legend's upper edge: X to the right, Y down.
    width
        Width of the legend, in m.
    columns
        Entries of the legend, column by column.
    """
    image = legend_image(columns)
    rows, columns, _ = image.shape
    height = width * rows / columns
    draw_picture(meshcat, path, image, RigidTransform([0, 0.5 * height, 0]), height)
    meshcat.SetTransform(path, X_WL)
