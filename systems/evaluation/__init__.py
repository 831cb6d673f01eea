"""Evaluation of a run against ground truth: logs, errors, metrics, plots and reports."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
