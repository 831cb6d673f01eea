"""Needle tracker that first corrects the poses of its volumes."""

from functools import partial
from typing import cast

from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, Diagram, System

from sonoservo.diagrams.needle_tracker import MakeNeedleTracker
from sonoservo.systems.signals.needle_estimate import NeedleEstimate
from sonoservo.systems.signals.volume import Volume

MakeCalibratedTracker = partial(MakeNeedleTracker, correct_poses=True)


def corrected_frame(
    tracker: Diagram, context: Context, volume: Volume, X_WL: RigidTransform
) -> RigidTransform:
    """Return the pose of a frame L of a volume after the volume's poses have been corrected."""
    corrected: Volume = tracker.GetOutputPort("corrected_volume").Eval(context)
    return corrected.X_WP.multiply(volume.X_WP.inverse()).multiply(X_WL)


def track_volume(tracker: System, context: Context, volume: Volume) -> NeedleEstimate:
    """Give a tracker its next volume, outside a simulation, and return the estimate."""
    tracker.GetInputPort("volume").FixValue(context, Value[object](volume))
    tracker.ExecuteForcedEvents(context)
    return cast(NeedleEstimate, tracker.GetOutputPort("estimate").Eval(context))
