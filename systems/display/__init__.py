"""Displays of a running simulation.

This room holds the colours, shapes and textured quads that both displays share. The room `world`
draws in Drake's Meshcat; the room `monitor` is the scanner's page. It imports `signals`,
`ultrasound` and `control`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
