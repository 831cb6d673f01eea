"""What a person types: the command line and its commands.

The functions behind the commands, such as `run` and `locate`, are handed out by
`sonoservo.diagrams`. This room may import every other.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
