"""Many runs: studies over seeds, their reports, and data sets.

It imports `diagrams` and `systems`, but neither `papers` nor `app`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
