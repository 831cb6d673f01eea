"""A changing line of text, shown live and in the recording."""

from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from sonoservo.systems.display.textured_quads import draw_picture, text_image
from sonoservo.systems.display.world.rod import Switch


class Label:
    """A changing line of text.

    Each new text gets a plate of its own (X along the text, -Y up), at most as high and wide as
    given in m, shown while the text holds.
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

        A text keeps the colours in which it is first shown.
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
