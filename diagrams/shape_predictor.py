"""Shape predictor: diagram that turns slices into a needle's cross-sections and predicted shape."""

from collections.abc import Iterable
from typing import Any

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Diagram

from sonoservo.systems.shape.cross_section import CrossSectionParameters
from sonoservo.systems.shape.cross_section_localizer import CrossSectionLocalizer
from sonoservo.systems.shape.cross_section_memory import CrossSectionMemory
from sonoservo.systems.shape.shape_estimator import ShapeEstimator
from sonoservo.systems.shape.shape_filter import ShapeFilter
from sonoservo.systems.shape.shape_filters import SHAPE_FILTERS
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.ports import DiagramBuilder


def MakeShapePredictor(
    *,
    localizer: CrossSectionParameters | None = None,
    shape_filter: ShapeFilter | None = None,
    X_WI: RigidTransform | None = None,
    period: float,
    offset: float = 0.0,
    seed: int = 0,
    click: bool = False,
) -> Diagram:
    """Make a shape predictor.

    .. pydrake_system::

        name: shape_predictor
        input_ports:
        - slice
        - click (on request)
        output_ports:
        - cross_section
        - shape

    ``slice`` is an `ImageSlice`, or a `NotFound` while there is none. ``cross_section`` is the
    `CrossSection` in it and ``shape`` the `NeedleShape` so far, or a `NotFound`. ``click`` is a
    person's `ImageClick` on the needle, or a `NotFound` before it.

    Parameters
    ----------
    localizer
        Settings of the search for cross-sections.
    shape_filter
        Filter of the shape estimator; None makes a particle filter with default parameters.
    X_WI
        Pose in W of the insertion's frame; see `ShapeEstimator`.
    period, offset
        Period and offset of the events at which it processes a new slice, in s.
    seed
        Seed of every random choice.
    click
        Whether to add the port ``click``, and to wait for a click on the needle.
    """
    parameters = localizer or CrossSectionParameters()
    if shape_filter is None:
        choice = SHAPE_FILTERS["particle_filter"]
        shape_filter = choice.make(choice.parameters())
    events = {"period": period, "offset": offset}
    builder = DiagramBuilder()
    localize = builder.AddNamedSystem(
        "cross_section_localizer", CrossSectionLocalizer(parameters=parameters)
    )
    # A start given by the user needs one slice only.
    given = click or parameters.start is not None
    start_slices = 1 if given else parameters.start_slices
    memory = builder.AddNamedSystem(
        "cross_section_memory", CrossSectionMemory(start_slices=start_slices, **events)
    )
    estimator = builder.AddNamedSystem(
        "shape_estimator",
        ShapeEstimator(shape_filter=shape_filter, X_WI=X_WI, seed=seed, **events),
    )
    image = builder.ExportInput(localize.GetInputPort("slice"), "slice")
    builder.ConnectInput(image, memory.GetInputPort("slice"))
    for source, port, target in (
        (memory, "cross_section_track", localize),
        (estimator, "shape", localize),
        (localize, "cross_section", memory),
        (localize, "cross_section", estimator),
    ):
        builder.Connect(source.GetOutputPort(port), target.GetInputPort(port))
    if click:
        builder.ExportInput(localize.GetInputPort("click"), "click")
    builder.ExportOutput(localize.GetOutputPort("cross_section"), "cross_section")
    builder.ExportOutput(estimator.GetOutputPort("shape"), "shape")
    diagram = builder.Build()
    diagram.set_name("shape_predictor")
    return diagram


def predict_from_slices(
    predictor: Diagram, slices: Iterable[ImageSlice]
) -> tuple[list[CrossSection | NotFound], list[NeedleShape | NotFound]]:
    """Predict a needle's shape from recorded slices, without a simulation."""
    context = predictor.CreateDefaultContext()
    found: list[CrossSection | NotFound] = []
    shapes: list[NeedleShape | NotFound] = []
    for each in slices:
        predictor.GetInputPort("slice").FixValue(context, Value[object](each))
        # The search must see the track before the slice; the forced event makes the one after it.
        found.append(predictor.GetOutputPort("cross_section").Eval(context))
        predictor.ExecuteForcedEvents(context)
        shapes.append(predictor.GetOutputPort("shape").Eval(context))
    return found, shapes


def estimate_shape(
    estimator: ShapeEstimator, cross_sections: Iterable[CrossSection]
) -> list[NeedleShape | NotFound]:
    """Estimate a needle's shape from recorded cross-sections, without a simulation."""
    # Time does not advance, so an event is forced for each cross-section.
    context = estimator.CreateDefaultContext()
    shapes: list[NeedleShape | NotFound] = []
    for each in cross_sections:
        estimator.GetInputPort("cross_section").FixValue(context, Value[object](each))
        estimator.ExecuteForcedEvents(context)
        shape: Any = estimator.GetOutputPort("shape").Eval(context)
        shapes.append(shape)
    return shapes
