"""Echo of a steel needle along its shaft and at its tip, from every angle."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive
from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.axes import frame_along
from sonoservo.systems.ultrasound.simulation.kernels.bright_echo import NeedleEcho, NeedleView

_WATER_SOUND_SPEED = 1480.0
_LONGEST_NEEDLE = 0.3
_NODE = 2e-3
_FACES = {"plain": 0, "bevel": 1, "diamond": 3, "blunt": 0}
_TIP_FLOOR = 10 ** (-15 / 20)
_WAVES = 12


@dataclass(kw_only=True)
class NeedleEchoParameters:
    """Parameters of a steel needle's echo; levels are amplitudes at the lens's focus.

    Parameters
    ----------
    specular_db
        Level at normal incidence, relative to the tissue's root mean square.
    diffuse_db
        Level of the part that the rough surface scatters in all directions, relative to
        ``specular_db``.
    tip_db
        Level of the part that the bevel scatters in all directions, as if from one point, relative
        to the tissue's root mean square.
    bevel_deg
        Angle between the bevel's face and the axis. The shaft's own echo fades along the bevel.
    reverberation_db
        Level of each echo inside the needle, relative to the previous one.
    inner_diameter_ratio
        Ratio of inner to outer diameter, which sets the distance between those echoes.
    shadow
        Share of the amplitude that is lost behind a needle in the middle of the beam.
    diffuse_lobe_deg
        Angle to the normal at which the rough surface's echo has fallen to one half. With a small
        angle, as for a polished needle, a steep needle is invisible. None for the same echo in all
        directions.
    fading_db, fading_length, fading_period
        Standard deviation of the shaft's level along it and over time, in dB (0 for no fading), and
        the distance in m and time in s over which the level changes.
    dimples_db, dimple_spacing, dimpled_length
        Level of each dimple of an echogenic needle, relative to the tissue's root mean square and
        the same at every angle (None for a smooth needle), distance in m between rings of dimples,
        and length in m of the dimpled part behind the tip.
    tip, tip_roll_deg
        Kind of tip, and rotation of its faces about the axis, in addition to the needle's own roll.
        "plain" scatters equally in all directions. "bevel" is bright if its face is turned to the
        probe, "diamond" has three such faces, and "blunt" has one facing forwards. At 0 deg, the
        first face looks up.
    """

    specular_db: float = 40.0
    diffuse_db: float = -20.0
    tip_db: float = 30.0
    bevel_deg: float = 20.0
    reverberation_db: float = -8.0
    inner_diameter_ratio: float = 0.66
    shadow: float = 0.45
    diffuse_lobe_deg: float | None = None
    fading_db: float = 0.0
    fading_length: float = 0.015
    fading_period: float = 2.0
    dimples_db: float | None = None
    dimple_spacing: float = 1e-3
    dimpled_length: float = 0.02
    tip: str = "plain"
    tip_roll_deg: float = 0.0

    def __post_init__(self) -> None:
        require(
            self.reverberation_db <= -3, "reverberation_db", self.reverberation_db, "at most -3 dB"
        )
        require(0 < self.bevel_deg <= 90, "bevel_deg", self.bevel_deg, "above 0, at most 90 deg")
        for name in ("inner_diameter_ratio", "shadow"):
            value = getattr(self, name)
            require(0 <= value <= 1, name, value, "from 0 to 1")
        require_not_negative(fading_db=self.fading_db)
        require(self.fading_db <= 30, "fading_db", self.fading_db, "at most 30 dB")
        require_positive(
            fading_length=self.fading_length,
            fading_period=self.fading_period,
            dimple_spacing=self.dimple_spacing,
            dimpled_length=self.dimpled_length,
        )
        if self.diffuse_lobe_deg is not None:
            allowed = 1 <= self.diffuse_lobe_deg <= 90
            require(allowed, "diffuse_lobe_deg", self.diffuse_lobe_deg, "from 1 to 90 deg")
        if self.dimples_db is not None:
            require(self.dimples_db <= 60, "dimples_db", self.dimples_db, "at most 60 dB")
        require(self.tip in _FACES, "tip", self.tip, f"one of {', '.join(_FACES)}")

    @property
    def bevel_length(self) -> float:
        """Ratio of the bevel's length to the needle's radius."""
        return 0.0 if self.tip == "blunt" else float(2 / np.tan(np.deg2rad(self.bevel_deg)))

    @property
    def varies(self) -> bool:
        """True if the echo depends on more than the position of the needle's points."""
        return (
            self.tip != "plain"
            or self.fading_db > 0
            or self.diffuse_lobe_deg is not None
            or self.dimples_db is not None
        )


def needle_echo(
    parameters: NeedleEchoParameters, beam: Beam, reference: int, rng: np.random.Generator
) -> tuple[NeedleEcho, NDArray[np.float64]]:
    """Return the amplitudes of a needle's points, and the phases due to its rough surface.

    Parameters
    ----------
    parameters
        Levels of the needle's echo.
    beam, reference
        Point spread function, and the sample at which the levels hold.
    rng
        Generator that draws the surface.
    """
    spacing, specular, diffuse = rod_amplitudes(
        parameters.specular_db, parameters.diffuse_db, beam, reference
    )
    tip = 10 ** (parameters.tip_db / 20)
    phases = rng.uniform(0, 2 * np.pi, int(_LONGEST_NEEDLE / spacing))
    bevel = parameters.bevel_length
    return NeedleEcho(spacing, specular, diffuse, tip, bevel, parameters.shadow), phases


def reverberations(
    parameters: NeedleEchoParameters, radius: float, sound_speed: float
) -> tuple[list[float], float]:
    """Return the levels of the echoes inside a water-filled needle, and their distance in m.

    The first echo is the front wall's; the series ends 40 dB below it.
    """
    ratio = 10 ** (parameters.reverberation_db / 20)
    count = 1 + int(-40 / parameters.reverberation_db)
    inner_diameter = 2 * radius * parameters.inner_diameter_ratio
    distance = inner_diameter * sound_speed / _WATER_SOUND_SPEED
    return [ratio**number for number in range(count)], distance


class NeedleFading:
    """Smooth random field of the shaft's level along a needle and over time.

    Parameters
    ----------
    parameters
        Parameters with the strength, length and period of the fading.
    rng
        Generator that draws the field.
    """

    def __init__(self, parameters: NeedleEchoParameters, rng: np.random.Generator) -> None:
        # A sum of waves has a Gaussian correlation of these lengths.
        self._along = rng.normal(size=_WAVES) / parameters.fading_length
        self._in_time = rng.normal(size=_WAVES) / parameters.fading_period
        self._phase = rng.uniform(0, 2 * np.pi, _WAVES)
        self._level = parameters.fading_db * np.sqrt(2 / _WAVES)

    def level_db(self, from_tip: NDArray[np.float64], time: float) -> NDArray[np.float64]:
        """Return the (n,) levels in dB at distances in m from the tip, at a time in s."""
        turns = np.multiply.outer(from_tip, self._along) + self._in_time * time + self._phase
        return self._level * np.cos(turns).sum(axis=-1)


def needle_view(
    parameters: NeedleEchoParameters,
    fading: NeedleFading,
    beam: Beam,
    needles: Sequence[Needle],
    X_FT: NDArray[np.float64],
    centre_offset: float,
    times: NDArray[np.float64],
) -> NeedleView:
    """Return the factors on a needle's echo in every frame, by angle, time and the tip's roll.

    Parameters
    ----------
    parameters, fading
        Parameters of the needle's echo, and its fading.
    beam
        Point spread function.
    needles
        Needle in T at each frame's time; empty ones are ignored.
    X_FT
        (frames, 3, 4) poses of the tissue in each frame's F.
    centre_offset
        Distance in m from F's origin back to the array's centre of curvature.
    times
        (frames,) times of the frames, in s.
    """
    longest = max(needle.length for needle in needles if needle)
    nodes = int(np.ceil(longest / _NODE)) + 2
    specular = np.ones((len(needles), nodes))
    diffuse = np.ones((len(needles), nodes))
    tips = np.ones(len(needles))
    from_tip: NDArray[np.float64] = _NODE * np.arange(nodes, dtype=np.float64)
    for frame, (needle, X, time) in enumerate(zip(needles, X_FT, times, strict=True)):
        if not needle:
            continue
        points = needle.position(np.maximum(needle.length - from_tip, 0))
        points = points @ X[:, :3].T + X[:, 3]
        rays: NDArray[np.float64] = np.add(points, (0.0, centre_offset, 0.0))
        rays[:, 2] = 0
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        axis = needle.shaft[-1] - needle.shaft[-2]
        axes = frame_along(axis) @ X[:, :3].T
        along = np.empty_like(points)
        along[:-1] = (points[:-1] - points[1:]) / _NODE
        along[np.append(from_tip[1:], np.inf) > needle.length] = axes[0]
        fade = 10 ** (fading.level_db(from_tip, float(time)) / 20)
        specular[frame] = fade
        diffuse[frame] = fade
        if parameters.diffuse_lobe_deg is not None:
            angle = np.rad2deg(np.arcsin(np.clip(np.abs((along * rays).sum(axis=1)), 0, 1)))
            diffuse[frame] *= 0.5 ** ((angle / parameters.diffuse_lobe_deg) ** 2)
        roll = needle.roll + np.deg2rad(parameters.tip_roll_deg)
        tips[frame] = _tip_factor(parameters, axes, rays[0], roll)
    dimples = parameters.dimples_db
    spacing = beam.wavelength / 8
    return NeedleView(
        specular=specular,
        diffuse=diffuse,
        tips=tips,
        points_per_node=_NODE / spacing,
        dimple=0.0 if dimples is None else float(10 ** (dimples / 20)),
        dimple_step=max(round(parameters.dimple_spacing / spacing), 1),
        dimpled=0 if dimples is None else int(parameters.dimpled_length / spacing),
    )


def _tip_factor(
    parameters: NeedleEchoParameters,
    axes: NDArray[np.float64],
    ray: NDArray[np.float64],
    roll: float,
) -> float:
    """Return the amplitude of the tip's echo, relative to that of a face turned to the probe.

    A matt face's echo falls with the square of the angle's cosine.

    Parameters
    ----------
    parameters
        Parameters with the kind of tip.
    axes
        (3, 3) axes in F as rows: along the needle, across it, and upwards.
    ray
        (3,) direction in which sound arrives, in F.
    roll
        Rotation of the first face about the axis in rad; at 0 it looks up.
    """
    if parameters.tip == "plain":
        return 1.0
    if parameters.tip == "blunt":
        normals = axes[:1]
    else:
        count = _FACES[parameters.tip]
        angles = roll + 2 * np.pi * np.arange(count) / count
        bevel = np.deg2rad(parameters.bevel_deg)
        aside = np.cos(angles)[:, np.newaxis] * axes[2] + np.sin(angles)[:, np.newaxis] * axes[1]
        normals = np.sin(bevel) * axes[0] + np.cos(bevel) * aside
    facing = np.maximum(-normals @ ray, 0) ** 2
    return float(max(np.sqrt((facing**2).sum()), _TIP_FLOOR))


def rod_amplitudes(
    level_db: float, diffuse_db: float, beam: Beam, reference: int, points_per_wavelength: int = 8
) -> tuple[float, float, float]:
    """Return the spacing in m and the specular and diffuse amplitudes of a thin rod's points."""
    spacing = beam.wavelength / points_per_wavelength
    width = beam.lateral[reference]
    # The amplitudes of points in phase add up under the beam.
    length = np.sqrt(2 * np.pi) * width
    specular = 10 ** (level_db / 20) * spacing / length
    # The intensities of points with random phases add up.
    length = np.sqrt(np.pi) * width
    diffuse = 10 ** ((level_db + diffuse_db) / 20) * np.sqrt(spacing / length)
    return spacing, specular, diffuse
