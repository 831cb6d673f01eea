"""Files of volumes: readers, writers and the player.

It reads NRRD and MetaImage, writes recordings with the truth beside them, and puts a recording
on a wire. It imports `signals` and `files`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
