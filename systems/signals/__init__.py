"""Values that travel on the wires between systems.

They are frozen and read-only. Their base class, the checks of arguments and the evaluation of a
port are here too. This room imports `sampling` only.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
