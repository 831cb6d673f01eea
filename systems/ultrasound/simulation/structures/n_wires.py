"""N-wires: three wires from which the pose of a frame follows, as in calibration phantoms."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import Positive
from sonoservo.systems.ultrasound.simulation.structures.structure import (
    Diffuse,
    Level,
    Rod,
    Structure,
)


@dataclass(kw_only=True)
class NWires(Structure):
    """Two parallel wires and one from the start of the first to the end of the second.

    A plane across them meets the diagonal wire at the same share of the width as of the length
    (Comeau et al. 1998), which gives the position of the plane.

    Parameters
    ----------
    centre
        Centre of the horizontal N in T, in m.
    length, width
        Length of the parallel wires, and distance between them, in m.
    azimuth_deg
        Direction of the parallel wires, from +X_T towards +Y_T.
    level_db, diffuse_db
        See `Fibre`.
    """

    kind: str = "n_wires"
    centre: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.05])
    length: Positive = 0.04
    width: Positive = 0.02
    azimuth_deg: float = 90.0
    level_db: Level = 34.0
    diffuse_db: Diffuse = -20.0

    def ends(self) -> NDArray[np.float64]:
        """Return the (3, 2, 3) ends of the wires in T, in m; the diagonal wire is the second."""
        angle = np.deg2rad(self.azimuth_deg)
        along = 0.5 * self.length * np.array([np.cos(angle), np.sin(angle), 0])
        across = 0.5 * self.width * np.array([-np.sin(angle), np.cos(angle), 0])
        corners = [
            [-along - across, along - across],
            [-along - across, along + across],
            [-along + across, along + across],
        ]
        return np.array(corners) + self.centre

    def rods(self) -> list[Rod]:
        """Return the three wires."""
        return [Rod(start, end, self.level_db, self.diffuse_db) for start, end in self.ends()]
