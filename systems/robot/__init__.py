"""Simulated robot and phantom.

The package contains the arm with its probe, the phantom on its stage, their contact, the wrist
force sensor and a stepper for a probe. It imports only `signals`, `files` and `models`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
