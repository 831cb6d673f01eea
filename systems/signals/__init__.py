"""Values that travel on the wires between systems.

The values are frozen and read-only. The package also contains their base class, the checks of
arguments and the evaluation of a port. It imports only `sampling`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
