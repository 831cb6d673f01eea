"""From echoes to volumes, as a scanner's console does it.

It holds transducers, beams, imaging settings and scan conversion; the room `simulation` in it
holds the simulated scanner. It imports `signals`, `sampling` and `files`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
