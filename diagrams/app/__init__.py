"""The command line and its commands.

`sonoservo.diagrams` exports the functions behind the commands, such as `run` and `locate`. This
room may import every other.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
