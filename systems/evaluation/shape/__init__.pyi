from .shape_metrics import ShapeLog as ShapeLog
from .shape_metrics import shape_coverage as shape_coverage
from .shape_metrics import shape_errors as shape_errors
from .shape_metrics import summarize_shape as summarize_shape
from .shape_plots import plot_shape as plot_shape
