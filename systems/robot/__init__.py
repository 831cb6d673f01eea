"""The simulated robot and what it touches.

It holds the arm with its probe, the phantom on its stage, their contact, the wrist force sensor
and a probe's stepper. It imports `signals`, `files` and `models`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
