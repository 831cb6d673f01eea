"""Logs of a run for viewers: Rerun's ``.rrd``, and ``.mcap`` for Foxglove and ROS 2."""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
