"""An environment of Gymnasium: a robot follows a needle, and an agent in place of the servo."""

import sys
from importlib import import_module

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

if sys.modules.get("gymnasium"):  # it imports what stands before the colon of an environment's name
    import_module(f"{__name__}.follow_needle")
