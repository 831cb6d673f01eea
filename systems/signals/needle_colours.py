"""Colours of the true and of the estimated needle, the same on every page, picture and screen.

Okabe and Ito's colours stay distinguishable under every kind of colour vision.
"""

TRUTH, ESTIMATE = "#56B4E9", "#E69F00"
"""Blue and orange, as a web page writes them."""


def red_green_blue(colour: str) -> tuple[int, int, int]:
    """Return red, green and blue from 0 to 255 of a colour as a web page writes it."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
