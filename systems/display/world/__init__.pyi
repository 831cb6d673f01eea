from .world_view import WorldView as WorldView
from .world_view import WorldViewParameters as WorldViewParameters
