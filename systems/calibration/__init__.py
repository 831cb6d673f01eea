"""Calibration: delay and hand-eye error of the volumes' poses, estimated from the images."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
