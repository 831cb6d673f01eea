"""Localizes the needle in one volume, given a prediction."""

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.estimation.track import NeedleTrack
from sonoservo.systems.localization.localize import localize
from sonoservo.systems.localization.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import evaluate
from sonoservo.systems.signals.volume import Volume


class NeedleLocalizer(LeafSystem):
    """Localizes the needle in one volume.

    .. pydrake_system::

        name: NeedleLocalizer
        input_ports:
        - volume
        - prediction
        output_ports:
        - measurement

    Stateless. Candidate voxels are the brightest ones around the predicted curve (Chatelain 2013,
    eq. 15); a random sample consensus fits the axis (eqs. 16-22); the tip is where the intensity
    along it drops. ``prediction`` is a `NeedleTrack`, ``measurement`` a `NeedleMeasurement` in W or
    a `NotFound` that says why there is none.

    Parameters
    ----------
    parameters
        Thresholds, in SI units.
    seed
        Of the random samples.
    """

    def __init__(
        self, *, parameters: NeedleLocalizerParameters | None = None, seed: int = 0
    ) -> None:
        super().__init__()
        self._parameters = parameters or NeedleLocalizerParameters()
        self._seed = seed
        self.DeclareAbstractInputPort("volume", Value[object]())
        self.DeclareAbstractInputPort("prediction", Value[object]())
        self.DeclareAbstractOutputPort(
            "measurement", lambda: Value[object](), self._calc_measurement
        )

    def _calc_measurement(self, context: Context, output: Value) -> None:
        volume = evaluate(self, context, "volume", (Volume, NotFound))
        track = evaluate(self, context, "prediction", NeedleTrack)
        if not isinstance(volume, Volume):
            output.set_value(volume)
            return
        # Keyed by the volume's time, so that a stateless system repeats itself.
        rng = np.random.default_rng([self._seed, int(abs(volume.time) * 1e9)])
        output.set_value(localize(volume, track, self._parameters, rng))
