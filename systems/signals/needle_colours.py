"""Colours of the true and of the estimated needle, the same on every page, picture and screen.

Okabe and Ito's colours stay distinguishable under every kind of colour vision.
"""

TRUTH, ESTIMATE = "#56B4E9", "#E69F00"
"""Blue and orange, as a web page writes them."""
