"""Difference between the clocks of scanner and arm, and what it does to the poses of frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.math import RigidTransform
from pydrake.trajectories import PiecewisePose

from sonoservo.systems.signals.requirements import Bounded, within


@dataclass(kw_only=True)
class ClockParameters(Bounded):
    """Scanner's clock, relative to that of arm and program.

    Parameters
    ----------
    offset
        Time by which the scanner's clock is ahead of the arm's, in s.
    drift
        Rate at which the scanner's clock gains on the arm's, in s/s; 1e-4 is 100 ppm.
    """

    offset: Annotated[float, within(-1, 1, " s")] = 0.0
    drift: Annotated[float, within(-0.01, 0.01)] = 0.0

    @property
    def is_right(self) -> bool:
        """True if the clocks agree."""
        return self.offset == 0 and self.drift == 0

    def stamp(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return what the scanner's clock says at times in s."""
        time = np.asarray(time, float)
        return time + (self.offset + self.drift * time)


def poses_at(
    stamps: NDArray[np.float64], times: ArrayLike, X_WP: Sequence[RigidTransform]
) -> NDArray[np.float64]:
    """Return the (frames, 4, 4) poses that a program gives to frames by their stamps in s.

    They are linear in position and along the shortest turn between the (m,) poses at ascending
    times by the arm's clock, and the nearest one beyond their ends.
    """
    path = PiecewisePose.MakeLinear(np.asarray(times), list(X_WP))
    return np.array([path.GetPose(stamp).GetAsMatrix4() for stamp in stamps])
