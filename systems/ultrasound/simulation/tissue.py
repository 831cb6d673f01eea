"""Acoustic model of a phantom's tissue."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from sonoservo.systems.files.model_file import model_file, read_section
from sonoservo.systems.files.refusals import refusing_failures
from sonoservo.systems.files.typed_yaml import load_typed
from sonoservo.systems.signals.body_surface import BodySurface
from sonoservo.systems.signals.requirements import (
    Bounded,
    NotNegative,
    Point,
    Positive,
    at_least,
    check_bounds,
    require,
    within,
)
from sonoservo.systems.ultrasound.simulation.anatomy.anatomies import (
    LabelMapAnatomy,
    LiverAnatomy,
)
from sonoservo.systems.ultrasound.simulation.anatomy.label_map import is_label_map
from sonoservo.systems.ultrasound.simulation.structures.kinds import (
    Bone,
    Calcification,
    Fascia,
    FatLayer,
    Gas,
    NWires,
    RestingNeedle,
    Vessel,
)

AnyStructure = Bone | Vessel | Fascia | Calcification | Gas | NWires | RestingNeedle
"""Kinds of structures, which the field ``kind`` selects."""


@dataclass(kw_only=True)
class Ball(Bounded):
    """A bright inclusion full of scatterers.

    Parameters
    ----------
    centre
        Centre of the ball in T, in m.
    radius
        Radius of the ball, in m.
    level_db
        Mean echo intensity relative to the tissue's, at the depth of the lens's focus.
    """

    centre: Point = field(default_factory=lambda: [0.0, 0.0, -0.04])
    radius: Positive = 1e-3
    level_db: float = 25.0


@dataclass(kw_only=True)
class Fibre:
    """A straight, thin, smooth inclusion that reflects sound as a needle does.

    Parameters
    ----------
    start, end
        Ends of the fibre in T, in m.
    level_db
        Amplitude of the echo at normal incidence relative to the tissue's, at the depth of the
        lens's focus.
    diffuse_db
        Level of the part that is scattered in all directions, relative to ``level_db``.
    """

    start: Point = field(default_factory=lambda: [-0.01, 0.0, -0.04])
    end: Point = field(default_factory=lambda: [0.01, 0.0, -0.04])
    level_db: float = 38.0
    diffuse_db: float = -22.0

    def __post_init__(self) -> None:
        check_bounds(self)
        require(self.start != self.end, "end", self.end, "another point than start")


@dataclass(kw_only=True)
class RandomFibres:
    """Fibres at random places in the tissue, as in muscle or a gland, drawn with its seed.

    Parameters
    ----------
    per_cubic_centimetre
        Mean number of fibre midpoints per cubic centimetre.
    shortest, longest
        Limits of their uniformly distributed lengths, in m.
    dimmest_db, brightest_db
        Limits of their uniformly distributed levels, in dB; see `Fibre`.
    direction
        Mean direction of the fibres in T.
    spread_deg
        Standard deviation of their direction about each axis across it, in deg.
    """

    per_cubic_centimetre: NotNegative = 0.0
    shortest: Positive = 3e-3
    longest: float = 12e-3
    dimmest_db: float = 18.0
    brightest_db: float = 30.0
    direction: list[float] = field(default_factory=lambda: [0.0, 1.0, 0.0])
    spread_deg: NotNegative = 20.0

    def __post_init__(self) -> None:
        check_bounds(self)
        _require_order(self, ("shortest", "longest"), ("dimmest_db", "brightest_db"))
        require(
            len(self.direction) == 3 and any(self.direction),
            "direction",
            self.direction,
            "three numbers, not all 0",
        )

    def draw(self, size: Sequence[float], rng: np.random.Generator) -> list[Fibre]:
        """Draw the fibres in a box of (3,) extents in m; their ends may lie beyond its faces."""
        count = rng.poisson(self.per_cubic_centimetre * 1e6 * float(np.prod(size)))
        middle = (rng.random((count, 3)) - [0.5, 0.5, 1.0]) * size
        along = np.array(self.direction) / np.linalg.norm(self.direction)
        along = along + np.deg2rad(self.spread_deg) * rng.normal(size=(count, 3))
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        half = 0.5 * rng.uniform(self.shortest, self.longest, (count, 1)) * along
        level = rng.uniform(self.dimmest_db, self.brightest_db, count)
        return [
            Fibre(start=start.tolist(), end=end.tolist(), level_db=float(decibels))
            for start, end, decibels in zip(middle - half, middle + half, level, strict=True)
        ]


@dataclass(kw_only=True)
class RandomBalls:
    """Balls at random places in the tissue, drawn with its seed: bubbles and grains.

    Parameters
    ----------
    per_cubic_centimetre
        Mean number of centres per cubic centimetre.
    smallest, largest
        Limits of their uniformly distributed radii, in m.
    dimmest_db, brightest_db
        Limits of their uniformly distributed levels, in dB; see `Ball`.
    """

    per_cubic_centimetre: NotNegative = 0.0
    smallest: Positive = 1.0e-3
    largest: float = 1.5e-3
    dimmest_db: float = 28.0
    brightest_db: float = 30.0

    def __post_init__(self) -> None:
        check_bounds(self)
        _require_order(self, ("smallest", "largest"), ("dimmest_db", "brightest_db"))

    def draw(self, size: Sequence[float], rng: np.random.Generator) -> list[Ball]:
        """Draw the balls in a box of (3,) extents in m."""
        count = rng.poisson(self.per_cubic_centimetre * 1e6 * float(np.prod(size)))
        centres = (rng.random((count, 3)) - [0.5, 0.5, 1.0]) * size
        radii = rng.uniform(self.smallest, self.largest, count)
        levels = rng.uniform(self.dimmest_db, self.brightest_db, count)
        return [
            Ball(centre=centre.tolist(), radius=float(radius), level_db=float(level))
            for centre, radius, level in zip(centres, radii, levels, strict=True)
        ]


@dataclass(kw_only=True)
class Tissue:
    """A body of scattering tissue. Frame T: origin at the middle of the top, +Z up.

    Parameters
    ----------
    size
        Extents along X, Y and Z of T, in m; the body reaches from z = -size[2] to 0.
    shape
        Shape of the body within these extents: "box", "cylinder" (lying along X_T, with equal
        extents along Y and Z) or "ellipsoid".
    scatterers_per_cell
        Effective number N of scatterers in a resolution cell, at every depth: the intensity's
        moments are <I^2> / <I>^2 = 2 + 1/N, those of a K distribution with nu = 2 N.
    level_db
        Mean echo intensity in dB, relative to the tissue to which all levels are related and for
        which the scanner's gain is set. It is below 0 dB for what scatters less, such as agar.
    attenuation
        One-way attenuation, in dB/(cm MHz). The scanner's time-gain compensation undoes it, so it
        shows as noise that grows with depth.
    balls, fibres
        Bright inclusions.
    random_balls, random_fibres
        Further inclusions at random places.
    structures
        Bone, vessels, fascia, calcifications, gas, N-wires and needles at rest.
    anatomy
        Label map that fills the box, whose size is then the map's; None for homogeneous tissue.
    sound_speed
        Speed of sound, in m/s; None for the one that the scanner assumes. With any other, objects
        appear deeper or shallower by the ratio of the two.
    fat
        Layer of fat on top, with a lower speed of sound.
    seed
        Seed of the scatterers and of the random inclusions.

    Raises
    ------
    ValueError
        If a value is out of range; the message names it.
    """

    size: list[float] = field(default_factory=lambda: [0.24, 0.16, 0.08])
    shape: str = "box"
    scatterers_per_cell: Annotated[float, within(0.5, 64)] = 4.0
    level_db: Annotated[float, within(-60, 20, " dB")] = 0.0
    attenuation: NotNegative = 0.5
    balls: list[Ball] = field(default_factory=list)
    fibres: list[Fibre] = field(default_factory=list)
    random_balls: RandomBalls = field(default_factory=RandomBalls)
    random_fibres: RandomFibres = field(default_factory=RandomFibres)
    structures: list[AnyStructure] = field(default_factory=list)
    anatomy: LabelMapAnatomy | LiverAnatomy | None = None
    sound_speed: Annotated[float | None, within(1300, 1800, " m/s")] = None
    fat: FatLayer = field(default_factory=FatLayer)
    seed: Annotated[int, at_least(0)] = 0

    def __post_init__(self) -> None:
        require(
            len(self.size) == 3 and min(self.size) > 0, "size", self.size, "three lengths above 0"
        )
        check_bounds(self)
        require(max(self.size) <= 2, "size", self.size, "at most 2 m each; lengths are in m")
        if self.surface.is_curved:
            level = self.fat.thickness == 0 and self.anatomy is None
            require(level, "shape", self.shape, "box with a layer of fat or a label map")
        for number, ball in enumerate(self.balls):
            self._require_within(f"balls[{number}].centre", ball.centre)
        for number, fibre in enumerate(self.fibres):
            self._require_within(f"fibres[{number}].start", fibre.start)
            self._require_within(f"fibres[{number}].end", fibre.end)

    def placed(self, entry: ArrayLike, direction: ArrayLike, layout: int | None = None) -> "Tissue":
        """Return the tissue with its structures moved to their positions beside the needle's path.

        The seed of a run, if given, draws a layout; see `BesideNeedle.drawn`.
        """
        structures = self.structures
        if layout is not None:
            rng = np.random.default_rng([layout, 7])
            structures = [each.drawn(layout, rng) for each in structures]
        return replace(self, structures=[each.placed(entry, direction) for each in structures])

    @property
    def surface(self) -> BodySurface:
        """Surface of the body."""
        return BodySurface(tuple(self.size), self.shape)

    def _require_within(self, name: str, point: list[float]) -> None:
        within = bool(self.surface.contains(point, slack=0.0))
        allowed = f"within the tissue, a {self.shape} {self.size} m large, z from its top"
        require(within, name, point, allowed)


def _require_order(parameters: object, *limits: tuple[str, str]) -> None:
    """Raise ValueError unless, of each pair of fields, the second is at least the first."""
    for low, high in limits:
        value = getattr(parameters, high)
        require(value >= getattr(parameters, low), high, value, f"at least {low}")


def load_tissue(name: str) -> Tissue:
    """Read the tissue of a phantom.

    Parameters
    ----------
    name
        Name of a file in ``models/phantoms`` ("agar"), or path of such a YAML file or of a label
        map (NRRD or NIfTI). Beside a label map, a YAML file of the same name must describe its
        labels: ``tissue: {anatomy: {labels: [{label: 1, level_db: -6}, ...]}}``.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If a value, or the label map, is not allowed.
    """
    path = model_file("phantoms", name)
    with refusing_failures(path):
        return _load_tissue(name, path)


def _load_tissue(name: str, path: Path) -> Tissue:
    content = read_section(path, "tissue", ("tissue", "contact"))
    if is_label_map(name):
        anatomy = content.get("anatomy") or {}
        require(isinstance(anatomy, dict), "anatomy", anatomy, "a mapping with a table of labels")
        content["anatomy"] = {"kind": "label_map", **anatomy, "file": name}
    tissue = load_typed(Tissue, content, f"{path}: tissue")
    if isinstance(tissue.anatomy, LabelMapAnatomy):
        own = path.parent / tissue.anatomy.file
        if own.is_file():
            tissue = replace(tissue, anatomy=replace(tissue.anatomy, file=str(own)))
    if tissue.anatomy is not None:
        tissue = replace(tissue, size=tissue.anatomy.grid().size)
    return tissue
