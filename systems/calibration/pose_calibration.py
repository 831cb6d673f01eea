"""Choice of the volumes whose tissue is compared, and what they say about the poses so far."""

import math
from dataclasses import dataclass, replace
from functools import cached_property

from sonoservo.systems.calibration.pose_errors import (
    PoseEquations,
    PoseErrors,
    estimate_pose_errors,
    pose_equations,
)
from sonoservo.systems.calibration.tissue_displacement import displacement_between
from sonoservo.systems.signals.immutable import Immutable, NotFound
from sonoservo.systems.signals.volume import Volume

_VOLUMES, _PAIRS = 12, 60  # Largest numbers of earlier volumes and of pairs that are kept
# Motion between two volumes in m and rad that tells most. After more of it, the speckle is
# another one; after less, the errors hardly show.
_TRANSLATION, _ROTATION = 3e-3, math.radians(4.0)
# Smallest and largest motion between two volumes that are compared, relative to those.
_LEAST, _MOST = 0.1, 2.0


@dataclass(frozen=True, eq=False)
class PoseCalibration(Immutable):
    """What the newest volumes, and the equations of pairs, say about the errors of their poses."""

    volumes: tuple[Volume, ...] = ()
    equations: tuple[PoseEquations, ...] = ()

    @cached_property
    def errors(self) -> PoseErrors | NotFound:
        """Errors of the poses, or a `NotFound` with the reason why they are unknown."""
        if not self.equations:
            return NotFound("no two volumes show the same tissue from different poses")
        return estimate_pose_errors(self.equations)

    def seen(self, volume: Volume) -> "PoseCalibration":
        """Return the calibration after one more volume, compared with the one that tells most."""
        kept = (*self.volumes, volume)[-_VOLUMES:]
        apart = [(_motion(earlier, volume), earlier) for earlier in self.volumes]
        near = [(abs(math.log(m)), each) for m, each in apart if _LEAST <= m <= _MOST]
        if not near:
            return replace(self, volumes=kept)
        earlier = min(near, key=lambda each: each[0])[1]
        seen = displacement_between(earlier, volume)
        if not len(seen.p_W):
            return replace(self, volumes=kept)
        equations = (*self.equations, pose_equations(earlier, volume, seen))[-_PAIRS:]
        return PoseCalibration(kept, equations)


def _motion(first: Volume, second: Volume) -> float:
    """Return the motion of the probe between two volumes, relative to that which tells most."""
    X = first.X_WP.InvertAndCompose(second.X_WP)
    moved = math.hypot(*X.translation()) / _TRANSLATION
    return math.hypot(moved, X.rotation().ToAngleAxis().angle() / _ROTATION)
