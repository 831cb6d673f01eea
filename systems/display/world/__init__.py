"""The world view, drawn with Drake's Meshcat.

It shows the probe, the phantom, the needle, its estimate and the slices, and it holds the
operator's controls. It imports `display` and everything that `display` imports.
"""
