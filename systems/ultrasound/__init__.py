"""Processing of a scanner's console, from echoes to volumes.

This room holds transducers, beams, imaging settings, scan conversion and the reconstruction of
volumes from 2D frames. Its room `simulation` holds the simulated scanner. It imports `signals`,
`sampling` and `files`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
