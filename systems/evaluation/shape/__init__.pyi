from .shape_log import ShapeLog as ShapeLog
from .shape_metrics import ShapeErrors as ShapeErrors
from .shape_metrics import cross_section_errors as cross_section_errors
from .shape_metrics import shape_coverage as shape_coverage
from .shape_metrics import shape_errors as shape_errors
from .shape_metrics import summarize_shape as summarize_shape
from .shape_plots import plot_shape as plot_shape
