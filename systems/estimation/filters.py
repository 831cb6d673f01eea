"""Registry of the needle filters, among which a tracker's field ``filter`` chooses."""

from functools import reduce
from operator import or_
from typing import TYPE_CHECKING, Any

from sonoservo.systems.estimation.axis_tip_filter import AxisTipFilter
from sonoservo.systems.estimation.control_point_filter import ControlPointFilter
from sonoservo.systems.estimation.needle_filter import NeedleFilter

FILTERS: tuple[type, ...] = (ControlPointFilter, AxisTipFilter)
"""All needle filters; a new one is a file and an entry here."""

if TYPE_CHECKING:
    AnyFilter = NeedleFilter[Any]
else:
    AnyFilter = reduce(or_, FILTERS)
    """Type of a field of a YAML file whose ``kind`` chooses the filter."""
