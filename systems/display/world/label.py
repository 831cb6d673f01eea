"""A line of text that changes, live and in a recording."""

from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from sonoservo.systems.display.textured_quads import draw_picture, text_image
from sonoservo.systems.display.world.rod import Switch


class Label:
    """A line of text on a plate. Each new text becomes a plate of its own, shown while it holds.

    Its frame has X along the text and -Y upwards, its origin in the plate's centre.

    Parameters
    ----------
    meshcat, path
        Where it is drawn.
    height, width
        Most of a plate, in m: a text that is too wide is written smaller.
    """

    def __init__(
        self, *, meshcat: Meshcat, path: str, height: float, width: float = np.inf
    ) -> None:
        self._meshcat, self._path = meshcat, path
        self._height, self._width = height, width
        self._plates: dict[str, Switch] = {}
        self._shown = ""

    def show(
        self,
        text: str,
        time: float,
        colour: Sequence[float] = (1, 1, 1),
        background: Sequence[float] = (0, 0, 0),
    ) -> None:
        """Show a text from a time on, in s; an empty one hides the label.

        Parameters
        ----------
        text
            To show.
        time
            From when on, in s.
        colour, background
            Red, green, blue from 0 to 1; a text keeps those that it is first shown in.
        """
        if text == self._shown:
            return
        if self._shown:
            self._plates[self._shown].set(False, time)
        if text:
            if text not in self._plates:
                self._plates[text] = self._plate(text, colour, background)
            self._plates[text].set(True, time)
        self._shown = text

    def _plate(self, text: str, colour: Sequence[float], background: Sequence[float]) -> Switch:
        path = f"{self._path}/{text.replace('/', ' ')}"
        image = text_image(text, colour, background)
        rows, columns, _ = image.shape
        height = min(self._height, self._width * rows / columns)
        draw_picture(self._meshcat, path, image, RigidTransform(), height)
        return Switch(meshcat=self._meshcat, path=path)
