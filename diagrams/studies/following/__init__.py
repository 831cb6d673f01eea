"""Studies of runs of following: two methods on the same seeds, judged from their logs."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
