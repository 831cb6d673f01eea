"""A page with a picture of a slice, in which a person points at something."""

import io
import json
import math
import queue
from base64 import b64encode
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from sonoservo.systems.display.pages.site import Document, Guarded, Site
from sonoservo.systems.signals.image_slice import ImageSlice

_PATIENCE = 0.2
"""Time in s for which the caller is deaf to an interruption from the keyboard."""


class ClickPage:
    """Shows a slice in a page, and waits for a click in it.

    Parameters
    ----------
    site
        Site to which the page "click" is added.
    image
        Slice to show.
    following
        Name of the site's page that opens after the click; empty to stay.

    Raises
    ------
    ValueError
        If the site has a page "click" already.
    """

    def __init__(self, site: Site, image: ImageSlice, *, following: str = "") -> None:
        self._site = site
        self._clicks: queue.Queue[tuple[float, float]] = queue.Queue()
        low = image.position((-0.5, -0.5))
        high = image.position(np.array(image.intensities.shape) - 0.5)
        shown = {
            "png": _data_address(image),
            "extent": (1e3 * np.array([*low, *(high - low)])).tolist(),
            "next": f"../{following}/" if following else "",
        }
        page = (files("sonoservo.systems.display.pages") / "click_page.html").read_text()
        text = page.replace("/* SLICE */", json.dumps(shown))
        taken = {"clicks": self._clicks, "low": low, "high": high}
        site.add(
            "click",
            "Point at the needle",
            [("", Document, {"text": text}), ("click", _Clicked, taken)],
        )

    @property
    def web_url(self) -> str:
        """Address of the page, with the token that opens it."""
        return self._site.address("click")

    def wait(self) -> NDArray[np.float64]:
        """Return the (2,) x and y in P of the first click, in m, once somebody has clicked."""
        while True:
            try:
                return np.array(self._clicks.get(timeout=_PATIENCE))
            except queue.Empty:
                continue


class _Clicked(Guarded):
    """Takes a click; one outside the slice, or that is no pair of numbers, is refused."""

    def initialize(self, clicks: "queue.Queue[tuple[float, float]]", low: Any, high: Any) -> None:
        self._clicks, self._low, self._high = clicks, low, high

    def check_xsrf_cookie(self) -> None:
        """Leave this to the site's rule, which has checked origin and token."""

    def post(self) -> None:
        try:
            sent = json.loads(self.request.body)
            place = float(sent["x"]), float(sent["y"])
        except (ValueError, TypeError, KeyError):
            place = (math.nan, math.nan)
        if not all(a <= each <= b for a, each, b in zip(self._low, place, self._high, strict=True)):
            self.set_status(400)
            return
        self._clicks.put(place)


def _data_address(image: ImageSlice) -> str:
    """Return the slice as the address of a PNG; depth runs down."""
    buffer = io.BytesIO()
    Image.fromarray(np.ascontiguousarray(image.intensities.T)).save(buffer, "PNG")
    return f"data:image/png;base64,{b64encode(buffer.getvalue()).decode()}"
