"""A line of text that stands in the world."""

from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from sonoservo.systems.display.colours import ink
from sonoservo.systems.display.textured_quads import draw_picture, text_image


class Sign:
    """A changing line of text in Meshcat.

    Parameters
    ----------
    meshcat, path
        Meshcat to draw in, and the path of the drawing.
    X_WSign
        Pose of the centre of its plate: X along the text, -Y upwards.
    height
        Height of its plate, in m.
    """

    def __init__(
        self, *, meshcat: Meshcat, path: str, X_WSign: RigidTransform, height: float = 0.02
    ) -> None:
        self._meshcat, self._path = meshcat, path
        self._X_WSign, self._height = X_WSign, height
        self._text = ""

    def show(self, text: str, background: tuple[float, float, float] = (0.3, 0.3, 0.3)) -> None:
        """Replace the text; an empty one removes the sign."""
        if text == self._text:
            return
        self._text = text
        if not text:
            self._meshcat.Delete(self._path)
            return
        image = text_image(text, ink(background), background)
        draw_picture(self._meshcat, self._path, image, self._X_WSign, self._height)
