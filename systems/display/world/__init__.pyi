from .shape_view import ShapeView as ShapeView
from .world_view import WorldView as WorldView
from .world_view import WorldViewParameters as WorldViewParameters
