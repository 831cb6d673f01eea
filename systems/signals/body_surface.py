"""Surface of a phantom's body: a box with a level top, a lying cylinder, or an ellipsoid."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sonoservo.systems.signals.requirements import require

Floats = NDArray[np.float64]

_ROUND = {"box": (0, 0, 0), "cylinder": (0, 1, 1), "ellipsoid": (1, 1, 1)}
_LEAST_RISE = 0.05


@dataclass(frozen=True)
class BodySurface:
    """Surface of a body inscribed in a box, whose highest point is the origin of T.

    Along the axes on which a body is round, u = (p - centre) / half of the extents satisfies
    ``|u|`` = 1 on its surface. Along the others, it ends at the faces of the box.
    """

    size: Sequence[float]
    """Extents along X, Y and Z of T, in m."""

    shape: str = "box"
    """A "box", a "cylinder" lying along X_T with equal extents along Y and Z, or an "ellipsoid"."""

    def __post_init__(self) -> None:
        require(self.shape in _ROUND, "shape", self.shape, f"one of {', '.join(_ROUND)}")
        if self.shape == "cylinder":
            y, z = self.size[1:]
            require(abs(y - z) < 1e-9, "size", list(self.size), "equal along Y and Z in a cylinder")

    @property
    def is_curved(self) -> bool:
        """True unless the body is a box."""
        return self.shape != "box"

    @property
    def bounds(self) -> Floats:
        """Lowest and highest corner in T in m; if curved, also flags of its round axes."""
        width, length, height = self.size
        rows = [[-width / 2, -length / 2, -height], [width / 2, length / 2, 0]]
        if self.is_curved:
            rows.append([float(each) for each in _ROUND[self.shape]])
        return np.array(rows)

    def contains(self, points: ArrayLike, slack: float = 1e-9) -> NDArray[np.bool_]:
        """Return for (..., 3) points in T whether they lie in the body, up to a slack in m."""
        p = np.asarray(points, dtype=float)
        low, high = self.bounds[:2]
        inside = ((p >= low - slack) & (p <= high + slack)).all(axis=-1)
        if not self.is_curved:
            return np.asarray(inside)
        u = self._scaled(p)
        return np.asarray(inside & (np.linalg.norm(u, axis=-1) <= 1 + slack / min(self.size)))

    def height(self, x: float, y: float) -> float:
        """Return the height z of the top in T over a point, in m, unless it is upright."""
        if not self.is_curved:
            return 0.0
        u = self._scaled(np.array([x, y, -self.size[2] / 2]))
        rise = 1 - float(u @ u)
        beyond = abs(x) > self.size[0] / 2 or abs(y) > self.size[1] / 2
        if beyond or rise < _LEAST_RISE:
            raise ValueError(
                f"x {x:.3f}, y {y:.3f} m is not on top of a {self.shape} of {list(self.size)} m"
            )
        return float((np.sqrt(rise) - 1) * self.size[2] / 2)

    def normal(self, point: ArrayLike) -> Floats:
        """Return the (3,) outward unit normal in T of the top at, or close to, a point in T."""
        if not self.is_curved:
            return np.array([0.0, 0.0, 1.0])
        gradient = self._scaled(np.asarray(point, dtype=float)) / np.asarray(self.size)
        return np.asarray(gradient / np.linalg.norm(gradient))

    def entry(self, aim: ArrayLike, direction: ArrayLike) -> Floats:
        """Return the (3,) point in T, in m, at which a line to an inner point enters."""
        p, d = np.asarray(aim, dtype=float), np.asarray(direction, dtype=float)
        inside = bool(self.contains(p))
        require(inside, "aim", p.tolist(), f"in the phantom, a {self.shape} of {list(self.size)} m")
        low, high = self.bounds[:2]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            back = np.where(d > 0, (p - low) / d, np.where(d < 0, (p - high) / d, np.inf))
        way = float(max(back.min(), 0.0))
        if self.is_curved:
            u, w = self._scaled(p), self._scaled(d, moved=False)
            a, b, c = float(w @ w), float(u @ w), float(u @ u) - 1
            if a > 1e-12:
                way = min(way, (b + np.sqrt(max(b * b - a * c, 0.0))) / a)
        return np.asarray(p - way * d)

    def _scaled(self, p: Floats, moved: bool = True) -> Floats:
        """Return coordinates on the round axes in half extents, from the centre unless a vector."""
        centre = np.array([0.0, 0.0, -self.size[2] / 2]) if moved else np.zeros(3)
        return np.asarray((p - centre) / (0.5 * np.asarray(self.size)) * _ROUND[self.shape])
