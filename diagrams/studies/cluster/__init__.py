"""Clusters of Dask distributed, imported on demand: the executor of a study on other machines."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
