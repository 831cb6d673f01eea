"""Displays of a running simulation.

The room `console` is the page on which a run is watched and controlled; the room `world` draws the
3D view in it with Drake's Meshcat. Colours, shapes and textured quads serve both.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
