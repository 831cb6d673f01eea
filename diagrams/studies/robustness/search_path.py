"""Leaf system that moves a probe over the phantom while its tracker follows nothing."""

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from sonoservo.diagrams.station import StationParameters
from sonoservo.systems.control.visual_features import needle_features, servo_velocity
from sonoservo.systems.signals.needle_estimate import NeedleEstimate, TrackingMode
from sonoservo.systems.signals.ports import declare_inputs, evaluate

_REACH = np.array([0.025, 0.012])  # half width of the path along X and Y of the phantom, in m
_PERIODS = np.array([31.0, 23.0, 37.0])  # periods of the motion along X and Y and of the turn, in s
_TURN = np.deg2rad(20)  # largest turn from the probe's first direction, in rad
_GAIN = 0.8  # rate in 1/s at which the probe approaches its place on the path


class SearchPath(LeafSystem):
    """Hands on a servo's velocity while a needle is followed, else moves along a planned path.

    .. pydrake_system::

        name: SearchPath
        input_ports:
        - planar_velocity
        - estimate
        - X_WP
        output_ports:
        - moving_velocity

    Velocities are (v_x, v_z, omega_y) of P, in P, in m/s and rad/s. From `start` in s on, the path
    leads over the phantom at up to 6 mm/s, and turns the probe by up to 20 deg.
    """

    def __init__(self, *, station: StationParameters, start: float) -> None:
        super().__init__()
        self._station, self._start = station, start
        declare_inputs(self, planar_velocity=3, estimate=NeedleEstimate, X_WP=RigidTransform)
        self.DeclareVectorOutputPort("moving_velocity", 3, self._calc_velocity)

    def _calc_velocity(self, context: Context, output: BasicVector) -> None:
        estimate = evaluate(self, context, "estimate", NeedleEstimate)
        follows = estimate.mode in (TrackingMode.TRACKING, TrackingMode.COASTING)
        if follows or context.get_time() < self._start:
            velocity = self.GetInputPort("planar_velocity").Eval(context)
        else:
            X_WP: RigidTransform = self.GetInputPort("X_WP").Eval(context)
            velocity = self._towards_path(context.get_time(), X_WP)
        output.SetFromVector(velocity)

    def _towards_path(self, time: float, X_WP: RigidTransform) -> NDArray[np.float64]:
        """Return the velocity towards the place on the path at a time, as eq. 25 gives it."""
        probe = self._station.probe
        x, y, turn = np.sin(2 * np.pi * (time - self._start) / _PERIODS) * [*_REACH, _TURN]
        heading = np.deg2rad(probe.yaw_deg) + turn
        X_PT = X_WP.InvertAndCompose(self._station.X_WT)
        place = X_PT.multiply(np.array([probe.x + x, probe.y + y, 0.0]))
        along = X_PT.rotation().multiply(np.array([np.cos(heading), np.sin(heading), 0.0]))
        features = needle_features(place, along)
        return servo_velocity(features, gain=_GAIN, rates=np.zeros(3), rotate=True)
