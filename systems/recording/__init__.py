"""Recordings of volumes: readers, writers and a player.

This room reads NRRD, MetaImage, NIfTI, DICOM and HDF5 files and folders of PNG images, writes
recordings with the ground truth beside them, and plays recordings back as a Drake system. It
imports `signals` and `files`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
