"""The poses that a device had of late, and which one it had at a given time."""

from bisect import bisect_left

from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.systems.signals.immutable import NotFound

_CAPACITY = 1024
# Time in s: what lies further back is a clock that was set anew, not a message that was late.
_JUMP = 1.0

BRIDGED = 0.5
"""Longest time in s between two poses over which poses are interpolated."""


class PoseHistory:
    """Poses with their times, bridged by interpolation over at most ``max_gap`` s."""

    def __init__(self, *, max_gap: float = BRIDGED, tolerance: float = 0.05) -> None:
        self._max_gap, self._tolerance = max_gap, tolerance
        self._times: list[float] = []
        self._poses: list[RigidTransform] = []

    def __len__(self) -> int:
        return len(self._times)

    @property
    def times(self) -> tuple[float, ...]:
        """Times of the poses that are known, in s."""
        return tuple(self._times)

    def add(self, time: float, X: RigidTransform) -> None:
        """Add a pose; one that is far older than the newest begins a new history."""
        if self._times and time < self._times[-1] - _JUMP:
            self._times.clear()
            self._poses.clear()
        at = bisect_left(self._times, time)
        if at < len(self._times) and self._times[at] == time:
            self._poses[at] = X
            return
        self._times.insert(at, time)
        self._poses.insert(at, X)
        if len(self._times) > _CAPACITY:
            del self._times[: _CAPACITY // 2], self._poses[: _CAPACITY // 2]

    def reaches(self, time: float) -> bool:
        """Return whether a pose at a time, or later, is known: waiting makes it no better."""
        return bool(self._times) and self._times[-1] >= time

    def at(self, time: float) -> RigidTransform | NotFound:
        """Return the pose at a time in s: linear in position, along the shortest turn."""
        if not self._times:
            return NotFound("there is no pose yet")
        above = bisect_left(self._times, time)
        if above < len(self._times) and self._times[above] == time:
            return self._poses[above]
        if 0 < above < len(self._times):
            start, end = self._times[above - 1], self._times[above]
            if end - start <= self._max_gap:
                part = (time - start) / (end - start)
                return interpolate(self._poses[above - 1], self._poses[above], part)
        near = min(
            range(max(above - 1, 0), min(above + 1, len(self._times))),
            key=lambda k: abs(self._times[k] - time),
        )
        apart = abs(self._times[near] - time)
        if apart <= self._tolerance:
            return self._poses[near]
        return NotFound(f"the nearest pose is {apart:.3f} s away")


def interpolate(start: RigidTransform, end: RigidTransform, part: float) -> RigidTransform:
    """Return a pose between two, at a part from 0 to 1 of the way."""
    turn = start.rotation().ToQuaternion().slerp(part, end.rotation().ToQuaternion())
    unit = Quaternion(turn.wxyz() / (turn.wxyz() @ turn.wxyz()) ** 0.5)
    position = (1 - part) * start.translation() + part * end.translation()
    return RigidTransform(RotationMatrix(unit), position)
