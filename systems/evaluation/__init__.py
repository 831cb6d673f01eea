"""What happened in a run, judged against ground truth.

It holds the log, errors, metrics, plots and the report. It imports `signals`, `ultrasound` and
`files`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
