"""Evaluation of a run against ground truth.

This room holds the logs, errors, metrics, plots and reports. It imports `signals`, `control`,
`ultrasound` and `files`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
