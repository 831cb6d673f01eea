"""Registry of the shape filters by name; a new one needs a file and a line here."""

from collections.abc import Callable
from typing import Any, NamedTuple

from sonoservo.systems.shape.shape_filter import ShapeEstimatorParameters, ShapeFilter
from sonoservo.systems.shape.shape_least_squares import (
    ShapeLeastSquares,
    ShapeLeastSquaresParameters,
)
from sonoservo.systems.shape.shape_particle_filter import ShapeParticleFilter
from sonoservo.systems.shape.shape_posterior import ShapeParticleFilterParameters


class ShapeFilterChoice(NamedTuple):
    """Class of a filter's parameters, and the function that makes the filter from them."""

    parameters: type[ShapeEstimatorParameters]
    make: Callable[[Any], ShapeFilter]


SHAPE_FILTERS = {
    "particle_filter": ShapeFilterChoice(ShapeParticleFilterParameters, ShapeParticleFilter),
    "least_squares": ShapeFilterChoice(ShapeLeastSquaresParameters, ShapeLeastSquares),
}
"""Name, parameters and filter of each of our shape estimators; a paper adds its own."""
