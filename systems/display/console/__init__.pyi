from .console import Console as Console
from .console_feed import ConsoleFeed as ConsoleFeed
from .controls import Control as Control
from .controls import OperatorPanel as OperatorPanel
from .readings import Sample as Sample
from .slices import slice_views as slice_views
