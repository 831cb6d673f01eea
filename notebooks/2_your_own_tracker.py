# %% [markdown]
# # Your own tracker
#
# A tracker is any Drake system with the input `volume` and the output `estimate`. Everything else
# (robot, ultrasound, controller, log, figures) stays the same. Here is a tracker in 30 lines. It
# searches every volume as a whole and has no memory.

# %%
# %matplotlib inline
import os

import matplotlib.pyplot as plt
import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from sonoservo.diagrams import load_scenario, locate_in, run, tracker_events
from sonoservo.systems.evaluation import estimate_errors, features
from sonoservo.systems.signals import NeedleEstimate, TrackingMode, Volume

changes = os.environ.get("SONOSERVO_QUICK", "duration=20").split()
scenario = load_scenario("chatelain2013_fig5", changes=changes)

# %% [markdown]
# * `volume` carries a `Volume` (grey levels on a grid in the probe frame P, and the pose `X_WP`
#   at its `time`), or a falsy `NotFound` before the first one.
# * `estimate` carries a `NeedleEstimate`: a mode, the needle's curve in the world frame W (entry
#   first, tip last), the velocity of its control points and their covariance.
# * The estimate is a state that is updated once per volume; the controller reads it about a hundred
#   times a second.

# %%
SEARCHING = NeedleEstimate(TrackingMode.SEARCHING, time=0.0)


class MemorylessTracker(LeafSystem):
    """Searches the whole of every volume for the needle."""

    def __init__(self, *, period, offset):
        super().__init__()
        self.DeclareAbstractInputPort("volume", Value[object]())
        estimate = self.DeclareAbstractState(Value[object](SEARCHING))
        self.DeclareStateOutputPort("estimate", estimate)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, offset, self._update)

    def _update(self, context, state):
        volume = self.GetInputPort("volume").Eval(context)
        if isinstance(volume, Volume):
            state.get_mutable_abstract_state(0).set_value(estimate_in(volume))


def estimate_in(volume):
    """Return the estimate from a single volume."""
    found = locate_in(volume)
    if not found:
        return NeedleEstimate(
            TrackingMode.SEARCHING, volume.time, volume_time=volume.time, reason=found.reason
        )
    return NeedleEstimate(
        TrackingMode.TRACKING,
        time=volume.time,
        curve=found.curve,
        velocity=np.zeros((2, 3)),  # a guess: at rest
        # Of two control points and their velocities, in three coordinates each: 1 mm, 10 mm/s.
        covariance=np.diag(np.repeat([1e-6, 1e-4], 6)),
        volume_time=volume.time,
    )


# %% [markdown]
# `tracker_events` returns the period and offset of the tracker's update event, so that it runs once
# per volume.

# %%
events = tracker_events(scenario)
print(f"every {events['period']:.3f} s, from {events['offset']:.3f} s on")

# %%
runs = {
    "Chatelain 2013": run(scenario),
    "without memory": run(scenario, tracker=MemorylessTracker(**events)),
}

# %% [markdown]
# Compare how soon the needle is found, the error of the tip, and its effect on the loop: the true
# position of the tip in the image, which the servo drives to X = 0.

# %%
figure, (error, place) = plt.subplots(2, 1, figsize=(9, 5), sharex=True)
for name, result in runs.items():
    log = result.log
    error.plot(log.volume_time, 1e3 * estimate_errors(log).tip, ".-", label=name)
    place.plot(log.time, 1e3 * features(log.X_WP, log.needle_tip, log.needle_entry)[:, 0])
error.set_ylabel("error of the tip (mm)")
error.legend()
place.axhline(0, color="0.6", linewidth=1)
place.set_ylabel("X of the true tip (mm)")
place.set_xlabel("time (s)")
plt.show()
# %%
for name, result in runs.items():
    tracking, compute = result.summary["tracking"], result.summary["compute_ms"]["track"]
    print(
        f"{name}: {tracking['tracked']} of {tracking['volumes']} volumes, "
        f"tip {tracking['tip_error_mm']['median']:.2f} mm (median), "
        f"{compute['median']:.1f} ms per volume"
    )

# %% [markdown]
# Without memory, whatever looks like a needle is accepted at once. Here that is the needle; in
# tissue with structures it is often something else. The built-in tracker waits until it has seen a
# line advance, predicts where to look with a Kalman filter, and gives the servo a velocity to feed
# forward. Errors only count volumes in which a tracker tracks, so the two medians are over
# different volumes. To build such a tracker, reuse the blocks in `diagrams/trackers`; each is a
# Drake system.
