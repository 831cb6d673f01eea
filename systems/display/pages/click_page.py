"""A page with a picture of a slice, in which a person clicks on the needle."""

import json
import math
from base64 import b64encode
from concurrent.futures import Future
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.display.pages.site import Document, Guarded, Site
from sonoservo.systems.display.textured_quads import encode_png
from sonoservo.systems.signals.image_slice import ImageSlice

Place = tuple[float, float]


class ClickPage:
    """Shows a slice in a page "click" of a site, and waits for the click on the needle in it."""

    def __init__(self, site: Site, image: ImageSlice) -> None:
        self._site = site
        self._clicked: Future[Place] = Future()
        low = image.position((-0.5, -0.5))
        high = image.position(np.array(image.intensities.shape) - 0.5)
        shown = {
            "png": f"data:image/png;base64,{b64encode(encode_png(image.intensities.T)).decode()}",
            "extent": (1e3 * np.array([*low, *(high - low)])).tolist(),
        }
        page = (files("sonoservo.systems.display.pages") / "click_page.html").read_text()
        text = page.replace("/* SLICE */", json.dumps(shown))
        taken = {"clicked": self._clicked, "low": low, "high": high}
        site.add(
            "click",
            "Click on the needle",
            [("", Document, {"text": text}), ("click", _Click, taken)],
        )

    @property
    def web_url(self) -> str:
        """Address of the page, with the token that opens it."""
        return self._site.address("click")

    def wait(self) -> NDArray[np.float64]:
        """Return the (2,) x and y in P of the first click, in m, once somebody has clicked."""
        return np.array(self._clicked.result())


class _Click(Guarded):
    """Takes the first click; one outside the slice, or that is no pair of numbers, is refused."""

    def initialize(self, clicked: "Future[Place]", low: Any, high: Any) -> None:
        self._clicked, self._low, self._high = clicked, low, high

    def post(self) -> None:
        try:
            sent = json.loads(self.request.body)
            place = float(sent["x"]), float(sent["y"])
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            place = (math.nan, math.nan)
        if not all(a <= each <= b for a, each, b in zip(self._low, place, self._high, strict=True)):
            self.set_status(400)
        elif self._clicked.done():
            self.set_status(409)
        else:
            self._clicked.set_result(place)
