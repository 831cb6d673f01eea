"""Leaf system that localizes the needle in one volume, given a prediction."""

from typing import Any, Protocol

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.localization_explanation import LocalizationExplanation
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.needle_prediction import NeedlePrediction
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.random_streams import random_stream
from sonoservo.systems.signals.volume import Volume


class LocalizationMethod(Protocol):
    """Form of `explain_localization` with its parameters."""

    def __call__(
        self, volume: Volume, prediction: NeedlePrediction | NotFound, *, rng: np.random.Generator
    ) -> LocalizationExplanation:
        """Localize the needle in a volume, and return all intermediate results."""


class NeedleLocalizer(LeafSystem):
    """Localizes the needle in one volume.

    .. pydrake_system::

        name: NeedleLocalizer
        input_ports:
        - volume
        - prediction
        output_ports:
        - measurement
        - explanation

    The system has no state. The candidate voxels are the brightest ones around the predicted curve
    (Chatelain 2013, eq. 15). A random sample consensus fits the axis (eqs. 16-22). The tip is the
    change point of the contrast along the axis. ``prediction`` is a `NeedlePrediction` or a
    `NotFound`. ``measurement`` is a `NeedleMeasurement` in W, or a `NotFound` with the reason why
    there is none. ``explanation`` is a `LocalizationExplanation` with all intermediate results, or
    a `NotFound` if there is no volume.

    Parameters
    ----------
    localize
        Function that localizes the needle, such as `explain_localization` with its parameters.
    seed
        Seed of the random samples.
    """

    def __init__(self, *, localize: LocalizationMethod, seed: int = 0) -> None:
        super().__init__()
        self._localize = localize
        self._seed = seed
        declare_inputs(self, volume=(Volume, NotFound), prediction=(NeedlePrediction, NotFound))
        declare_output(self, "measurement", (NeedleMeasurement, NotFound), self._calc_measurement)
        # The cache entry of this port serves both outputs, so the explanation costs nothing extra.
        declare_output(
            self, "explanation", (LocalizationExplanation, NotFound), self._calc_explanation
        )

    def _calc_explanation(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        prediction = evaluate(self, context, "prediction", (NeedlePrediction, NotFound))
        if not isinstance(volume, Volume):
            output.set_value(volume)
            return
        rng = random_stream(self._seed, "localization", volume.time)
        output.set_value(self._localize(volume, prediction, rng=rng))

    def _calc_measurement(self, context: Context, output: Value) -> None:
        found: Any = self.GetOutputPort("explanation").Eval(context)
        output.set_value(found.measurement if isinstance(found, LocalizationExplanation) else found)
