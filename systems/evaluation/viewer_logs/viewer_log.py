"""What a log for a viewer can hold: the face of its formats."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.volume import Volume

Floats = NDArray[np.float64]

Colour = tuple[int, int, int]  # red, green and blue from 0 to 255


class ViewerLog(Protocol):
    """A file with one time line in s of the simulation; what is named ``probe/...`` is in P."""

    def poses(self, name: str, times: Floats, X_WF: Floats) -> None:
        """Write (n, 4, 4) poses of a frame in W."""

    def lines(self, name: str, times: Floats, points: Floats, colour: Colour) -> None:
        """Write (n, m, 3) polylines; one with NaN is cleared."""

    def ellipsoids(self, name: str, times: Floats, centres: Floats, covariances: Floats) -> None:
        """Write the ellipsoids of 95 % of (n, 3, 3) covariances in m^2; NaN clears."""

    def scalars(self, name: str, times: Floats, values: Floats) -> None:
        """Write (n,) numbers; NaN is left out."""

    def texts(self, name: str, times: Floats, texts: Sequence[str]) -> None:
        """Write texts at the times at which they change."""

    def image(self, name: str, time: float, grey: NDArray[np.uint8]) -> None:
        """Write (rows, columns) grey levels."""

    def volume(self, time: float, volume: Volume) -> None:
        """Write a volume."""

    def close(self) -> None:
        """Give the file its final name."""


def changes(times: Floats, texts: Sequence[str]) -> list[tuple[float, str]]:
    """Return the times at which a text begins to stand."""
    kept: list[tuple[float, str]] = []
    for time, text in zip(times, texts, strict=True):
        if not kept or kept[-1][1] != str(text):
            kept.append((float(time), str(text)))
    return kept


def ellipsoid_axes(covariance: Floats) -> tuple[Floats, Floats]:
    """Return the half axes in m of 95 % of a (3, 3) covariance, and the rotation to them."""
    values, R = np.linalg.eigh(covariance)
    if np.linalg.det(R) < 0:
        R[:, 0] *= -1
    return np.sqrt(7.815 * np.maximum(values, 0)), R  # the 95 % point of chi-squared with 3 degrees
