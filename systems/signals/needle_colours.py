"""Colours of needles and lines, the same on every page, picture and screen.

Okabe and Ito's colours stay distinguishable under every kind of colour vision.
"""

TRUTH, ESTIMATE = "#56B4E9", "#E69F00"
"""True needle and the estimated one, blue and orange, as a web page writes them."""

LINE_COLOURS = {
    "needle": ESTIMATE, "resting": "#aab2bd", "riding": "#25cf97", "appeared": "#d98cc4",
}  # fmt: skip
"""Colours of the lines that are followed, by their class."""
