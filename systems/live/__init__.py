"""Live volumes, poses and estimates, to and from other programs.

Messages become volumes on a wire, and what is on the wires becomes messages; sockets and protocols
are in `connection`. This room imports `ultrasound`, `recording` and what these import.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
