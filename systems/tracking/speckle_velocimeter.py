"""Speckle tracking: the tip's velocity from the speckle around it in two volumes."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem
from scipy.signal import hilbert

from sonoservo.systems.shape.normalized_cross_correlation import best_match
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    between,
    check_bounds,
    require,
)
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.signals.volume import Volume, acquired_from


@dataclass(kw_only=True)
class SpeckleVelocimeterParameters:
    """Windows and thresholds of the speckle velocimeter.

    Parameters
    ----------
    kind
        Name of the velocimeter, always "speckle".
    kernel
        Number of elements of the kernel along each axis of the array: X, Y and Z of a `Volume`, or
        frame, line and sample of a `RadioFrequencySweep`. The numbers are odd, which puts the tip
        in the middle.
    search
        Number of elements of the search region along the same axes. It is centred on the predicted
        tip.
    min_correlation
        Smallest correlation of the best match at which it is accepted.
    max_distance
        Largest distance from the predicted to the measured tip, in m. A match farther away is
        another place that looks alike.
    displacement_std
        Standard deviation of the displacement along each axis of the array, in elements.
    min_speed_std
        Standard deviation of the velocity in every direction that remains however well the speckle
        correlates, in m/s. The default was found at 3.3 MHz with a steel needle at 5 mm/s, in
        volumes 0.6 s apart. The needle's mirror-like echo and the tissue are at rest, and the
        measured speed is 2 to 3 mm/s too low. Choose a smaller value if the speckle moves with the
        needle.
    along_axis
        Whether only the velocity's component along the needle is kept, as a needle moves along its
        axis.
    envelope
        Whether radio-frequency lines are compared by their envelope. The paper does not specify
        this. The carrier is finer, but a needle that moves across a sector turns relative to the
        scan lines. After 1 mm at 50 mm depth the correlation is 0.4 for the carrier and 0.9 for the
        envelope.
    """

    kind: str = "speckle"
    kernel: list[int] = field(default_factory=lambda: [11, 7, 7])
    search: list[int] = field(default_factory=lambda: [17, 13, 13])
    min_correlation: Annotated[float, between(0, 1)] = 0.6
    max_distance: Positive = 5e-3
    displacement_std: list[float] = field(default_factory=lambda: [0.5, 0.5, 0.5])
    min_speed_std: NotNegative = 4e-3
    along_axis: bool = False
    envelope: bool = True

    def __post_init__(self) -> None:
        require(self.kind == "speckle", "kind", self.kind, '"speckle"')
        for name in ("kernel", "search"):
            value = getattr(self, name)
            odd = len(value) == 3 and all(n >= 1 and n % 2 == 1 for n in value)
            require(odd, name, value, "three odd numbers")
        holds = all(m <= M for m, M in zip(self.kernel, self.search, strict=True))
        require(holds, "search", self.search, f"at least kernel, {self.kernel}")
        positive = len(self.displacement_std) == 3 and all(d > 0 for d in self.displacement_std)
        require(positive, "displacement_std", self.displacement_std, "three numbers above 0")
        check_bounds(self)


Speckle = Volume | RadioFrequencySweep
"""Types in which speckle can be tracked; both give the positions of their elements."""

Floats = NDArray[np.float64]


def _values(speckle: Speckle) -> NDArray[np.float32] | NDArray[np.uint8]:
    return speckle.intensities if isinstance(speckle, Volume) else speckle.lines


def _element(speckle: Speckle, p_W: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the (3,) index of the element nearest to a position in W."""
    element = speckle.index(acquired_from(speckle, p_W[np.newaxis])[0])
    return np.asarray(np.round(element), dtype=np.int64)


def _window(
    speckle: Speckle, centre: NDArray[np.int64], shape: list[int], envelope: bool
) -> NDArray[Any] | None:
    """Return the elements around a centre, or None if the array does not contain them all.

    The envelope is taken of whole lines, as it is wrong near the ends of a line that is cut off.
    """
    first = centre - np.array(shape) // 2
    values = _values(speckle)
    if np.any(first < 0) or np.any(first + shape > values.shape):
        return None
    frames, lines, samples = (slice(a, a + m) for a, m in zip(first, shape, strict=True))
    if envelope and isinstance(speckle, RadioFrequencySweep):
        return np.asarray(np.abs(hilbert(values[frames, lines]))[..., samples])
    return values[frames, lines, samples]


def measure_velocity(
    current: Speckle,
    previous: Speckle,
    p_WBefore: NDArray[np.float64],
    p_WPredicted: NDArray[np.float64],
    direction: NDArray[np.float64],
    parameters: SpeckleVelocimeterParameters,
) -> VelocityMeasurement | NotFound:
    """Measure the tip's velocity in W by speckle tracking (Zhao 2012, section 2.3).

    The kernel lies around the tip in the previous volume, the search region around its prediction
    in the current one.
    """
    # The published search region reaches 5 samples (0.14 mm) axially, whereas 1 mm/s along the
    # published direction moves 0.34 mm between volumes. It can contain the published motion only
    # if it is centred on the predicted displacement, as it is here.
    before, ahead = _element(previous, p_WBefore), _element(current, p_WPredicted)
    kernel = _window(previous, before, parameters.kernel, parameters.envelope)
    search = _window(current, ahead, parameters.search, parameters.envelope)
    if kernel is None or search is None:
        return NotFound("the window around the tip extends beyond the volume")
    match = best_match(search, kernel)
    if isinstance(match, NotFound):
        return match
    if match.correlation < parameters.min_correlation:
        return NotFound(f"the speckle has changed: its correlation is {match.correlation:.2f}")
    if match.at_border.any():
        return NotFound("the speckle has moved out of the search region")
    reach = (np.array(parameters.search) - parameters.kernel) // 2
    found = ahead + match.position - reach
    ends = [each.to_world(each.position(at[np.newaxis].astype(float))) for each, at in (
        (previous, before), (current, found))]  # fmt: skip
    moved, elapsed = (ends[1][n][0] - ends[0][n][0] for n in (0, 1))
    if not elapsed > 0:
        return NotFound("the volumes were acquired at the same time")
    aside = moved - (p_WPredicted - p_WBefore)
    if np.linalg.norm(aside) > parameters.max_distance:
        apart = 1e3 * np.linalg.norm(aside)
        return NotFound(f"the best match is {apart:.1f} mm away from the prediction")
    steps = current.position(found + np.eye(3)) - current.position(found)
    scaled = current.X_WP.rotation().matrix() @ (steps.T * parameters.displacement_std) / elapsed
    covariance = scaled @ scaled.T + parameters.min_speed_std**2 * np.eye(3)
    velocity = moved / elapsed
    if parameters.along_axis:
        velocity = (velocity @ direction) * direction
    return VelocityMeasurement(velocity, covariance, match.correlation)


VelocityMethod = Callable[
    [Speckle, Speckle, Floats, Floats, Floats], VelocityMeasurement | NotFound
]
"""Form of `measure_velocity` with its parameters."""


class SpeckleVelocimeter(LeafSystem):
    """Measures the tip's velocity from the speckle around it, or by another method.

    .. pydrake_system::

        name: SpeckleVelocimeter
        input_ports:
        - volume
        - previous_volume
        - prediction
        output_ports:
        - velocity

    The system has no state. ``volume`` and ``previous_volume`` are both a `Volume` or both a
    `RadioFrequencySweep`. ``prediction`` is a `NeedlePrediction` or a `NotFound`. ``velocity`` is a
    `VelocityMeasurement` in W, or a `NotFound` with the reason why there is none.

    Parameters
    ----------
    measure
        Function that measures the velocity, such as `measure_velocity` with its parameters.
    """

    def __init__(self, *, measure: VelocityMethod) -> None:
        super().__init__()
        self._measure = measure
        declare_inputs(
            self,
            volume=(Volume, RadioFrequencySweep, NotFound),
            previous_volume=(Volume, RadioFrequencySweep, NotFound),
            prediction=(NeedlePrediction, NotFound),
        )
        declare_output(self, "velocity", (VelocityMeasurement, NotFound), self._calc_velocity)

    def _calc_velocity(self, context: Context, output: Value) -> None:
        current = self._speckle(context, "volume")
        previous = self._speckle(context, "previous_volume")
        prediction = evaluate(self, context, "prediction", (NeedlePrediction, NotFound))
        if isinstance(current, NotFound):
            output.set_value(current)
        elif isinstance(previous, NotFound):
            output.set_value(previous)
        elif isinstance(prediction, NotFound) or prediction.curve is None:
            output.set_value(NotFound("no needle is being tracked"))
        elif type(current) is not type(previous):
            output.set_value(NotFound("the previous volume is of another kind"))
        else:
            assert prediction.velocity is not None
            curve, time, velocity = prediction.curve, prediction.time, prediction.velocity[-1]
            before, predicted = (
                curve.tip + (each.time - time) * velocity for each in (previous, current)
            )
            output.set_value(self._measure(current, previous, before, predicted, curve.direction))

    def _speckle(self, context: Context, port: str) -> Speckle | NotFound:
        value = evaluate(self, context, port, (Volume, RadioFrequencySweep, NotFound))
        assert isinstance(value, (Volume, RadioFrequencySweep, NotFound))
        return value
