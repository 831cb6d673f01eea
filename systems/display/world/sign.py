"""A line of text that stands in the world."""

from pydrake.geometry import Meshcat
from pydrake.math import RigidTransform

from sonoservo.systems.display.colours import ink
from sonoservo.systems.display.textured_quads import draw_picture, text_image


class Sign:
    """A line of text in Meshcat that may change.

    Parameters
    ----------
    meshcat, path
        Where it is drawn.
    X_WSign
        Where it stands: its centre, X along it, -Y upwards.
    height
        Of its plate, in m.
    """

    def __init__(
        self, *, meshcat: Meshcat, path: str, X_WSign: RigidTransform, height: float = 0.02
    ) -> None:
        self._meshcat, self._path = meshcat, path
        self._X_WSign, self._height = X_WSign, height
        self._text = ""

    def show(self, text: str, background: tuple[float, float, float] = (0.3, 0.3, 0.3)) -> None:
        """Show a text in place of the last one."""
        if text == self._text:
            return
        self._text = text
        if not text:
            self._meshcat.Delete(self._path)
            return
        image = text_image(text, ink(background), background)
        draw_picture(self._meshcat, self._path, image, self._X_WSign, self._height)
