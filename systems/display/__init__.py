"""Displays of a running simulation.

This room holds the colours, shapes and textured quads that both displays share. The room `console`
is the page on which a run is watched and controlled; the room `world` draws the 3D view in it with
Drake's Meshcat. It imports `signals`, `ultrasound` and `control`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
