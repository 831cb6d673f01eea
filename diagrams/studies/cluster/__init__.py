"""Clusters of Dask distributed: the executor of a study on other machines.

Dask is imported on demand; it comes with the extra ``cluster``.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
