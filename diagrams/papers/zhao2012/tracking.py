"""Zhao 2012's tracker on the radio-frequency sweeps of the simulated probe."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.common.value import Value

from sonoservo.diagrams.papers.zhao2012.method.whole_volume_ransac import (
    WholeVolumeRansacParameters,
    localize_in_whole_volume,
)
from sonoservo.diagrams.trackers.zhao2012 import MakeZhao2012Tracker, Zhao2012TrackerParameters
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.needle_measurement import NeedleMeasurement
from sonoservo.systems.signals.radio_frequency_sweep import RadioFrequencySweep
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.signals.velocity_measurement import VelocityMeasurement
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.tracking.axis_tip_filter import AxisTipFilter
from sonoservo.systems.tracking.localizer_parameters import NeedleLocalizerParameters
from sonoservo.systems.tracking.needle_motion import NeedleMotionParameters
from sonoservo.systems.tracking.ransac import RansacParameters
from sonoservo.systems.tracking.speckle_velocimeter import SpeckleVelocimeterParameters
from sonoservo.systems.tracking.tip import TipParameters
from sonoservo.systems.tracking.track_manager import TrackManager
from sonoservo.systems.tracking.track_parameters import TrackParameters
from sonoservo.systems.ultrasound.radio_frequency import detect_envelope, detected_geometry
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid

KEPT_VOLUME = 60e-9
"""Total volume of the voxels that thresholding keeps, in m^3; not published."""

_RANSAC = RansacParameters(residual_threshold=1e-3, min_separation=1e-3)
_TIP = TipParameters(
    tube_radius=0.5e-3, background_radius=3e-3, smoothing=0.75e-3, bevel_length=0.0
)

VELOCIMETER = SpeckleVelocimeterParameters(
    kernel=[7, 21, 51],
    search=[11, 37, 61],
    min_correlation=0.5,
    max_distance=1e-3,
    displacement_std=[0.2, 0.2, 0.3],
)
"""Parameters with the published windows, in planes, lines and samples."""


@dataclass(frozen=True)
class Noise:
    """Noise that the paper does not publish, the same in every direction, of both filters.

    `tip`, `turning`: Q of the tip in m^2/s^3 and of the direction in rad^2/s. `velocity_std`: of R,
    in m/s. The kernel also holds tissue at rest, so the velocity is some per cent too small, by
    much the same in every volume. A filter that takes this for noise trusts it ever more, and lags.
    """

    tip: float = 1e-9
    turning: float = 2e-6
    velocity_std: float = 2e-3

    def filter(self, **more: Any) -> AxisTipFilter:
        """Return the filter with this noise Q."""
        motion = NeedleMotionParameters(insertion=0, body=self.tip)
        return AxisTipFilter(motion=motion, turning=self.turning, **more)

    def velocimeter(self, **more: Any) -> SpeckleVelocimeterParameters:
        """Return the velocimeter with the published windows and this noise R."""
        return replace(VELOCIMETER, min_speed_std=self.velocity_std, **more)


def tracker_parameters() -> Zhao2012TrackerParameters:
    """Return the tracker's parameters for a beam 1 mm wide and a hand that pushes evenly.

    The paper publishes only the windows. The other values were tuned on seeds from 100 on.
    """
    return Zhao2012TrackerParameters(
        localizer=NeedleLocalizerParameters(
            ransac=_RANSAC,
            tip=_TIP,
            max_angle_deg=20.0,
            max_radius=5e-3,
            cross_section=1.5e-6,
            slab=1e-3,
            min_length=2e-3,
            min_evidence=6e-3,
            correlation_length=0.05e-3,
            tip_std=0.15e-3,
            entry_std=0.3e-3,
            systematic_std=0.02e-3,
            # This needle is a cloud of scatterers, without a wall that would reflect.
            echo_offset=0.0,
        ),
        velocimeter=Noise().velocimeter(),
        filter=Noise().filter(first_speed_std=1e-3, first_drift_std=0.2e-3),
        # The dynamic needle begins with 5 mm.
        track=TrackParameters(withdrawn_length=2e-3),
    )


class BMode:
    """Conversion of the phantom's radio-frequency sweeps to grey volumes of 0.4 mm voxels."""

    _STEP = 4
    _DEPTHS = (0.034, 0.066)
    _HALF_WIDTH = 0.024

    def __init__(self, geometry: SweepGeometry) -> None:
        detected = detected_geometry(geometry, self._STEP)
        lower = [-self._HALF_WIDTH, self._DEPTHS[0], -self._HALF_WIDTH]
        upper = [self._HALF_WIDTH, self._DEPTHS[1], self._HALF_WIDTH]
        self._convert = ScanConversion(detected, make_grid(detected, 0.4e-3, lower, upper))

    def __call__(self, sweep: RadioFrequencySweep) -> Volume:
        """Detect the envelope over 60 dB from 20 dB below the tissue's mean, and convert it."""
        near, far = self._DEPTHS[0] - 1e-3, self._DEPTHS[1] + 1e-3
        return self._convert(
            # The grid's corners are farther from the array than its depth.
            detect_envelope(sweep, step=self._STEP, floor_db=-20.0, near=near, far=1.2 * far)
        )


def localize_as_published(
    volume: Volume,
    towards: NDArray[np.float64],
    refits: int,
    rng: np.random.Generator,
    candidate_volume: float = KEPT_VOLUME,
) -> NeedleMeasurement | NotFound:
    """Localize the needle by RANSAC in the whole volume; see `localize_in_whole_volume`."""
    parameters = WholeVolumeRansacParameters(
        candidate_volume=candidate_volume, ransac=replace(_RANSAC, refits=refits), tip=_TIP
    )
    found = localize_in_whole_volume(volume, towards, parameters, rng)
    if isinstance(found, NotFound):
        return found
    independent = max((found.tip - found.start) / 1e-3, 4.0)
    return found.measurement(volume.time, 1e-3, independent)


@dataclass(frozen=True, eq=False)
class Tracked:
    """Estimate of RANSAC and Kalman filter after a volume, RANSAC's and velocimeter's results."""

    estimate: NeedleEstimate
    measurement: NeedleMeasurement | NotFound
    velocity: VelocityMeasurement | NotFound


class Tracking:
    """Tracker that is called for each volume, without a simulation."""

    def __init__(self, towards: NDArray[np.float64], seed: int, with_velocity: bool = True) -> None:
        self._towards = towards
        self._with_velocity = with_velocity
        self._rng = np.random.default_rng([seed, 3])
        self._tracker = MakeZhao2012Tracker(
            parameters=tracker_parameters(), period=1.0, seed=seed, speckle_port=True
        )
        self._context = self._tracker.CreateDefaultContext()
        self._started = False

    def __call__(self, sweep: RadioFrequencySweep, volume: Volume) -> Tracked:
        """Track the needle in the next sweep and its volume; the first starts the tracker."""
        speckle = sweep if self._with_velocity else NotFound("the velocity is not measured")
        for port, value in (("volume", volume), ("speckle", speckle)):
            self._tracker.GetInputPort(port).FixValue(self._context, Value[object](value))
        velocimeter = self._tracker.GetSubsystemByName("speckle_velocimeter")
        context = velocimeter.GetMyContextFromRoot(self._context)
        velocity = velocimeter.GetOutputPort("velocity").Eval(context)
        measurement = None if self._started else self._start(volume)
        self._tracker.ExecuteForcedEvents(self._context)
        if measurement is None:
            measurement = self._tracker.GetOutputPort("measurement").Eval(self._context)
        estimate = self._tracker.GetOutputPort("estimate").Eval(self._context)
        return Tracked(estimate, measurement, velocity)

    def _start(self, volume: Volume) -> NeedleMeasurement | NotFound:
        found = localize_as_published(volume, self._towards, 3, self._rng)
        if isinstance(found, NeedleMeasurement):
            manager = self._tracker.GetSubsystemByName("track_manager")
            assert isinstance(manager, TrackManager)
            manager.start_at(manager.GetMyMutableContextFromRoot(self._context), found)
            self._started = True
        return found
