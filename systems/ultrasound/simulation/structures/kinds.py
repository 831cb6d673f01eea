"""Kinds of structures: bone, calcifications, fasciae, fat, gas, wires, needles at rest, vessels."""

import itertools
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import (
    Bound,
    Bounded,
    Fraction,
    NotNegative,
    Positive,
    require,
    within,
)
from sonoservo.systems.ultrasound.simulation.axes import distance_to_segment, frame_along
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleEchoParameters
from sonoservo.systems.ultrasound.simulation.structures.structure import (
    Diffuse,
    Extents,
    Level,
    Repeated,
    Rod,
    Structure,
    Surfaces,
    Tube,
    up_to,
)
from sonoservo.systems.ultrasound.simulation.structures.surface import Surface, parametric

Floats = NDArray[np.float64]


@dataclass(kw_only=True)
class Bone(Structure):
    """A long bone, a rib or a pubic ramus: a cylinder with an elliptical cross-section.

    Parameters
    ----------
    start, end
        Ends of the axis in T, in m.
    width, thickness
        Horizontal and vertical axes of the ellipse, in m. A wide, thin ellipse is a flat bone.
    level_db, diffuse_db, shadow, reverberation_db
        See `SurfaceEcho`. Cortical bone reflects about -6 dB of the sound at normal incidence and
        soft tissue scatters -50 to -60 dB of it, so bone stands out by 45 to 50 dB.
    """

    POINTS: ClassVar[tuple[str, ...]] = ("start", "end")

    kind: str = "bone"
    start: list[float] = field(default_factory=lambda: [0.0, -0.03, -0.05])
    end: list[float] = field(default_factory=lambda: [0.0, 0.03, -0.05])
    width: Positive = 0.012
    thickness: Positive = 0.008
    level_db: Level = 45.0
    diffuse_db: Diffuse = -20.0
    shadow: Fraction = 1.0
    reverberation_db: Repeated = -14.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.start != self.end, "end", self.end, "another point than start")

    @property
    def reach(self) -> float:
        """Half of the shorter axis, in m."""
        return min(self.width, self.thickness) / 2

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return the bone's hull without its ends."""
        start, axis = np.array(self.start), np.subtract(self.end, self.start)
        _, across, up = frame_along(axis)

        def position(u: Floats, v: Floats) -> Floats:
            angle = 2 * np.pi * v[:, np.newaxis]
            around = self.width * np.cos(angle) * across + self.thickness * np.sin(angle) * up
            return start + u[:, np.newaxis] * axis + around / 2

        perimeter = np.pi * max(self.width, self.thickness)
        hull = parametric(position, (float(np.linalg.norm(axis)), perimeter), spacing)
        return [(_outward(hull, start, axis), self.surface_echo(one_sided=True))]


def _outward(hull: Surface, start: Floats, axis: Floats) -> Surface:
    """Return the hull with normals that point away from its axis."""
    share = (hull.points - start) @ axis / (axis @ axis)
    outward = np.einsum("ij,ij->i", hull.normals, hull.points - start - share[:, None] * axis)
    return Surface(hull.points, hull.normals * np.sign(outward)[:, None], hull.areas)


@dataclass(kw_only=True)
class Calcification(Structure):
    """A rough grain of calcium.

    Parameters
    ----------
    centre
        Centre of the grain in T, in m.
    radius
        Radius of the grain, in m.
    level_db
        Amplitude of the echo relative to the tissue's at the lens's focus, for a grain that fills
        the beam.
    shadow
        See `SurfaceEcho`.
    """

    kind: str = "calcification"
    centre: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.04])
    radius: Annotated[float, up_to(0.02)] = 1.5e-3
    level_db: Level = 34.0
    shadow: Fraction = 0.9

    @property
    def reach(self) -> float:
        """Radius of the grain, in m."""
        return self.radius

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return a sphere that scatters in all directions."""
        step = min(spacing / 1.5, self.radius / 3)
        count = int(np.ceil(4 * np.pi * (self.radius / step) ** 2))
        # A golden spiral spreads points evenly on a sphere.
        height = 1 - 2 * (np.arange(count) + 0.5) / count
        angle = np.pi * (1 + np.sqrt(5)) * np.arange(count)
        ring = np.sqrt(1 - height**2)
        normals = np.stack([ring * np.cos(angle), ring * np.sin(angle), height], axis=-1)
        area = 4 * np.pi * self.radius**2 / count
        sphere = Surface(self.centre + self.radius * normals, normals, np.full(count, area))
        return [(sphere, self.surface_echo(diffuse_db=0.0, one_sided=True, specular=False))]


@dataclass(kw_only=True)
class Fascia(Structure):
    """A rectangular, wavy sheet.

    Parameters
    ----------
    centre
        Centre of the sheet in T, in m.
    size
        Extents in m, along X and Y of T before the sheet is tilted.
    azimuth_deg, dip_deg
        Direction in which the sheet falls, from +X_T towards +Y_T, and angle by which it falls.
    wave_height, wave_length
        Amplitude and length of the waves, in m.
    level_db, diffuse_db, shadow
        See `SurfaceEcho`.
    """

    kind: str = "fascia"
    centre: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.03])
    size: Extents = field(default_factory=lambda: [0.06, 0.04])
    azimuth_deg: float = 0.0
    dip_deg: Annotated[float, within(-90, 90, " deg")] = 0.0
    wave_height: NotNegative = 0.2e-3
    wave_length: Positive = 0.02
    level_db: Level = 28.0
    diffuse_db: Diffuse = -12.0
    shadow: Fraction = 0.05

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return the sheet, whose waves have random phases."""
        phase = rng.uniform(0, 2 * np.pi, 2)
        R = turned(self.azimuth_deg, self.dip_deg)

        def position(u: Floats, v: Floats) -> Floats:
            x, y = (u - 0.5) * self.size[0], (v - 0.5) * self.size[1]
            rate = 2 * np.pi / self.wave_length
            height = np.sin(rate * x + phase[0]) + np.sin(rate * y + phase[1])
            flat = np.stack([x, y, self.wave_height / 2 * height], axis=-1)
            return self.centre + flat @ R.T

        sheet = parametric(position, (self.size[0], self.size[1]), spacing)
        return [(sheet, self.surface_echo())]


def turned(azimuth_deg: float, dip_deg: float) -> Floats:
    """Return the rotation that makes a level sheet fall by ``dip_deg`` towards ``azimuth_deg``."""
    (ca, sa), (cd, sd) = ((np.cos(a), np.sin(a)) for a in np.deg2rad([azimuth_deg, dip_deg]))
    about_z = np.array([[ca, -sa, 0], [sa, ca, 0], [0, 0, 1]])
    about_y = np.array([[cd, 0, sd], [0, 1, 0], [-sd, 0, cd]])
    return about_z @ about_y @ about_z.T


@dataclass(kw_only=True)
class FatLayer(Bounded):
    """Fat from the top of the tissue down to a level face. The probe lies directly on it.

    Parameters
    ----------
    thickness
        Thickness of the layer, in m; 0 for no fat.
    sound_speed
        Speed of sound, in m/s; 1430 to 1480 in fat (Duck 1990).
    level_db
        Level of the layer's scatterers relative to the tissue's.
    attenuation
        One-way attenuation, in dB/(cm MHz); None for the tissue's.
    """

    thickness: Annotated[float, within(0, 0.2, " m")] = 0.0
    sound_speed: Annotated[float, within(1300, 1700, " m/s")] = 1450.0
    level_db: Annotated[float, within(-100, 40, " dB")] = -4.0
    attenuation: Annotated[float | None, within(0, 30, " dB/cm/MHz")] = None


@dataclass(kw_only=True)
class Gas(Structure):
    """The upper face of gas in bowel, lung or an abscess.

    Parameters
    ----------
    centre, size
        Centre in T and extents along X and Y of T, in m.
    roughness, bump_length
        Standard deviation of the surface's height and distance between its bumps, in m.
    level_db, diffuse_db, shadow
        See `SurfaceEcho`.
    ring_down_db, ring_down_length
        Ring-down, which makes the shadow dirty; see `SurfaceEcho`.
    """

    kind: str = "gas"
    centre: list[float] = field(default_factory=lambda: [0.0, 0.0, -0.05])
    size: Extents = field(default_factory=lambda: [0.02, 0.02])
    roughness: Annotated[float, within(0, 5e-3, " m")] = 0.4e-3
    bump_length: Positive = 4e-3
    level_db: Level = 44.0
    diffuse_db: Diffuse = -10.0
    shadow: Fraction = 0.97
    ring_down_db: Annotated[float, Bound("at most 0 dB", lambda level: level <= 0)] = -34.0
    ring_down_length: Positive = 0.04

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return the upper face."""
        counts = [min(int(np.ceil(size / self.bump_length)) + 4, 200) for size in self.size]
        heights = self.roughness * rng.normal(size=counts)
        bumps = RectBivariateSpline(*(np.linspace(0, 1, n) for n in counts), heights)

        def position(u: Floats, v: Floats) -> Floats:
            x, y = (u - 0.5) * self.size[0], (v - 0.5) * self.size[1]
            return self.centre + np.stack([x, y, bumps(u, v, grid=False)], axis=-1)

        face = parametric(position, (self.size[0], self.size[1]), spacing)
        # The patch is oval, so that no straight edge is visible.
        offsets = (face.points - self.centre)[:, :2] / np.array(self.size)
        oval = (offsets**2).sum(axis=1) <= 0.25
        shown = Surface(face.points[oval], face.normals[oval], face.areas[oval])
        return [(shown, self.surface_echo(one_sided=True))]


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

    def ends(self) -> Floats:
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


@dataclass(kw_only=True)
class RestingNeedle(Structure):
    """A straight needle at rest; a thin one without reverberation represents a guide wire.

    Parameters
    ----------
    start, end
        Entry and tip in T, in m.
    diameter
        Outer diameter, in m; 1.27 mm is gauge 18, 0.89 mm is a guide wire.
    echo
        Parameters of the needle's echo.
    """

    POINTS: ClassVar[tuple[str, ...]] = ("start", "end")

    kind: str = "needle"
    start: list[float] = field(default_factory=lambda: [-0.04, 0.0, -0.03])
    end: list[float] = field(default_factory=lambda: [0.02, 0.0, -0.05])
    diameter: Annotated[float, up_to(5e-3)] = 1.27e-3
    echo: NeedleEchoParameters = field(default_factory=NeedleEchoParameters)

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.start != self.end, "end", self.end, "another point than start")

    @property
    def reach(self) -> float:
        """Radius of the needle, in m."""
        return self.diameter / 2

    def needle(self) -> Needle:
        """Return the needle in T."""
        return Needle(np.array([self.start, self.end]), self.diameter / 2)


@dataclass(kw_only=True)
class Vessel(Structure):
    """A vessel along a polyline.

    Parameters
    ----------
    path
        Points of the axis in T, in m.
    radius
        Mean inner radius, in m.
    lumen_db
        Level of the blood relative to the tissue.
    level_db, diffuse_db, shadow
        Levels and shadow of the wall; see `SurfaceEcho`.
    pulsation, heart_rate
        Amplitude of the radius relative to its mean (0.05 in a carotid artery, 0 in a vein), and
        its frequency in Hz.
    flow_speed
        Mean speed of the blood, in m/s; it decorrelates the lumen's speckle. 0 for none.
    attenuation
        One-way attenuation of the blood, in dB/(cm MHz). It is below that of tissue, so the tissue
        behind the vessel is brighter.
    """

    POINTS: ClassVar[tuple[str, ...]] = ("path",)

    kind: str = "vessel"
    path: list[list[float]] = field(
        default_factory=lambda: [[-0.03, 0.0, -0.045], [0.03, 0.0, -0.045]]
    )
    radius: Annotated[float, up_to(0.05)] = 3e-3
    lumen_db: Level = -35.0
    level_db: Level = 36.0
    diffuse_db: Diffuse = -16.0
    shadow: Fraction = 0.0
    pulsation: Annotated[float, within(0, 0.5)] = 0.05
    heart_rate: Positive = 1.2
    attenuation: NotNegative = 0.18
    flow_speed: Annotated[float, within(0, 2, " m/s")] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(len(self.path) >= 2, "path", self.path, "at least two points")
        steps = np.linalg.norm(np.diff(self.path, axis=0), axis=1)
        require(bool((steps > 1e-6).all()), "path", self.path, "points apart from each other")

    @property
    def reach(self) -> float:
        """Mean inner radius of the vessel, in m."""
        return self.radius

    def surfaces(self, spacing: float, rng: np.random.Generator) -> Surfaces:
        """Return the wall of each straight piece."""
        walls = []
        ends = np.array(self.path)
        for start, end in itertools.pairwise(ends):
            wall = _wall(start, end - start, self.radius, spacing)
            # Where two pieces meet, the part inside the other piece is not wall.
            outside = np.ones(len(wall.points), bool)
            for other, stop in itertools.pairwise(ends):
                if other is not start and not np.array_equal(other, start):
                    distance = distance_to_segment(wall.points, other, stop)
                    outside &= distance > 0.98 * self.radius
            walls.append(Surface(wall.points[outside], wall.normals[outside], wall.areas[outside]))
        return [(wall, self.surface_echo()) for wall in walls]

    def tubes(self) -> list[Tube]:
        """Return the lumen."""
        return [
            Tube(
                np.array(self.path),
                self.radius,
                self.lumen_db,
                self.attenuation,
                self.pulsation,
                self.heart_rate,
                self.flow_speed,
            )
        ]


def _wall(start: Floats, axis: Floats, radius: float, spacing: float) -> Surface:
    _, across, up = frame_along(axis)

    def position(u: Floats, v: Floats) -> Floats:
        angle = -2 * np.pi * v[:, np.newaxis]
        around = radius * (np.cos(angle) * across + np.sin(angle) * up)
        return start + u[:, np.newaxis] * axis + around

    lengths = (float(np.linalg.norm(axis)), 2 * np.pi * radius)
    return parametric(position, lengths, spacing)
