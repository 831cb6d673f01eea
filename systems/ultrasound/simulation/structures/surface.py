"""Smooth surfaces as pieces that are small compared with the beam: points, normals and areas."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.immutable import Immutable, Shape
from sonoservo.systems.signals.requirements import require

MAX_PIECES = 2_000_000
"""Largest number of pieces of one surface."""


@dataclass(frozen=True, eq=False)
class Surface(Immutable):
    """Centres of a surface's pieces in T, in m, their outward unit normals, and areas in m^2."""

    points: Annotated[NDArray[np.float64], Shape("n", 3)]
    normals: Annotated[NDArray[np.float64], Shape("n", 3)]
    areas: Annotated[NDArray[np.float64], Shape("n")]


@dataclass(frozen=True)
class SurfaceEcho(Immutable):
    """Acoustic properties of a surface.

    Parameters
    ----------
    level_db
        Amplitude of the echo of a large, flat surface at normal incidence, relative to the tissue's
        root mean square, at the lens's focus.
    diffuse_db
        Level of the part that a rough surface scatters in all directions, relative to
        ``level_db``.
    shadow
        Share of the amplitude that is lost behind the surface, both ways.
    one_sided
        Whether only the side that faces the probe reflects.
    specular
        Whether the surface is smooth enough for specular reflection; if not, the whole echo is
        diffuse.
    reverberation_db
        Level of each echo after another round trip between surface and probe, relative to the
        previous one; None for no such echoes.
    ring_down_db, ring_down_length
        Initial level of the reverberation behind the surface, relative to the surface's echo (None
        for no ring-down), and depth in m over which it falls by 20 dB.
    """

    level_db: float
    diffuse_db: float = -20.0
    shadow: float = 0.0
    one_sided: bool = False
    specular: bool = True
    reverberation_db: float | None = None
    ring_down_db: float | None = None
    ring_down_length: float = 0.02


def parametric(
    position: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]],
    lengths: tuple[float, float],
    spacing: float,
) -> Surface:
    """Divide a surface into nearly square pieces at most ``spacing`` m apart.

    ``position`` gives (n, 3) points in m at (n,) parameters u and v from 0 to 1, along which the
    surface is ``lengths`` m long. The normal is the cross product of its derivatives by u and v.
    """
    counts = [max(int(np.ceil(length / spacing)), 3) for length in lengths]
    require(counts[0] * counts[1] <= MAX_PIECES, "surface", lengths, "smaller, in m")
    u, v = (
        axis.ravel()
        for axis in np.meshgrid(
            *((np.arange(count) + 0.5) / count for count in counts), indexing="ij"
        )
    )
    step = 1e-5
    along = (position(u + step, v) - position(u - step, v)) / (2 * step)
    across = (position(u, v + step) - position(u, v - step)) / (2 * step)
    normals = np.cross(along, across)
    stretch = np.linalg.norm(normals, axis=1)
    normals /= np.maximum(stretch, 1e-30)[:, np.newaxis]
    return Surface(position(u, v), normals, stretch / len(u))
