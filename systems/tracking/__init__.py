"""One belief about the lines in the volumes, and the measurement and filters of the needle.

The package finds a needle among all lines, localizes it in each volume and estimates it from all
volumes so far. It imports only `signals`, `sampling` and `shape`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
