"""Echo of a steel needle along its shaft and at its tip, from every angle.

A smooth cylinder mirrors sound as a line of points in phase does (Wear and Harris 2008, "Frequency
dependence of backscatter from thin, oblique, finite-length cylinders"): the beam's integral along
it gives the narrow dependence on the angle. The tip's wall and faces add up in phase in the same
way, piece by piece (Kirchhoff's integral). The rest of the echo, from a rough surface, has random
phases.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    check_bounds,
    require,
    within,
)
from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.needles.needle_kernel import (
    NeedleEcho,
    NeedleView,
    incidence,
    together,
)
from sonoservo.systems.ultrasound.simulation.needles.needle_tip import (
    FACES,
    tip_axes,
    tip_surface,
    width_left,
)

_WATER_SOUND_SPEED = 1480.0
_LONGEST_NEEDLE = 0.3
_NODE = 2e-3
_WAVES = 12
_GAUGE_18 = 0.635e-3
_PIECES_PER_WAVELENGTH = 3
"""Pieces of the tip's surface less than half a wavelength apart alias at no angle, two ways."""


@dataclass(kw_only=True)
class NeedleEchoParameters:
    """Parameters of a steel needle's echo; levels are amplitudes at the lens's focus.

    The defaults are those of ``models/needles/biopsy.yaml``, a smooth biopsy needle.

    Parameters
    ----------
    specular_db
        Level of a needle of gauge 18 at normal incidence, relative to the tissue's root mean
        square. The intensity is proportional to the radius, as that of any rigid cylinder much
        thicker than the wavelength is.
    diffuse_db
        Level of the part that the rough surface scatters, relative to ``specular_db`` and, with
        ``diffuse_lobe_deg``, at normal incidence.
    tip, bevel_deg
        Kind of tip, and angle between its faces and the axis. A "bevel" has one face, a "diamond"
        three, and a "blunt" tip ends in a disc.
    tip_roll_deg
        Rotation of the first face about the axis, in addition to the needle's own roll; at 0 deg,
        it looks up.
    reverberation_db
        Level of each echo inside the needle, relative to the previous one.
    inner_diameter_ratio
        Ratio of inner to outer diameter, which sets the distance between those echoes.
    shadow
        Share of the amplitude that is lost behind a needle in the middle of the beam.
    diffuse_lobe_deg
        Angle to the normal at which the amplitude of the rough surface's echo has fallen to one
        half, in a Gaussian. None for the same echo in all directions.
    fading_db, fading_length, fading_period
        Standard deviation of the shaft's level along it and over time, in dB (0 for no fading), and
        the distance in m and time in s over which the level changes.
    dimples_db, dimple_spacing, dimpled_length
        Level of each dimple of an echogenic needle, relative to the tissue's root mean square and
        the same at every angle (None for a smooth needle), distance in m between rings of dimples,
        and length in m of the dimpled part behind the tip.
    """

    specular_db: float = 40.0
    diffuse_db: float = -26.0
    diffuse_lobe_deg: float | None = 35.0
    tip: str = "bevel"
    bevel_deg: Annotated[float, within(5, 85, " deg")] = 20.0
    tip_roll_deg: float = 0.0
    reverberation_db: float = -8.0
    inner_diameter_ratio: float = 0.66
    shadow: float = 0.45
    fading_db: NotNegative = 0.0
    fading_length: Positive = 0.015
    fading_period: Positive = 2.0
    dimples_db: float | None = None
    dimple_spacing: Positive = 1e-3
    dimpled_length: Positive = 0.02

    def __post_init__(self) -> None:
        require(
            self.reverberation_db <= -3, "reverberation_db", self.reverberation_db, "at most -3 dB"
        )
        check_bounds(self)
        for name in ("inner_diameter_ratio", "shadow"):
            value = getattr(self, name)
            require(0 <= value <= 1, name, value, "from 0 to 1")
        require(self.fading_db <= 30, "fading_db", self.fading_db, "at most 30 dB")
        if self.diffuse_lobe_deg is not None:
            allowed = 1 <= self.diffuse_lobe_deg <= 90
            require(allowed, "diffuse_lobe_deg", self.diffuse_lobe_deg, "from 1 to 90 deg")
        if self.dimples_db is not None:
            require(self.dimples_db <= 60, "dimples_db", self.dimples_db, "at most 60 dB")
        require(self.tip in FACES, "tip", self.tip, f"one of {', '.join(FACES)}")

    @property
    def bevel_length(self) -> float:
        """Ratio of the length of the tip's faces to the needle's radius."""
        across = {"bevel": 2, "diamond": 1, "blunt": 0}[self.tip]
        return float(across / np.tan(np.deg2rad(self.bevel_deg)))


def needle_echo(
    parameters: NeedleEchoParameters,
    beam: Beam,
    reference: int,
    phases: NDArray[np.complex128],
    pulse: NDArray[np.float32],
    radius: float,
) -> NeedleEcho:
    """Return the amplitudes of a needle of a radius in m, with levels that hold at a sample."""
    spacing, specular, diffuse = rod_amplitudes(
        parameters.specular_db, parameters.diffuse_db, beam, reference
    )
    thick = np.sqrt(radius / _GAUGE_18)
    length = parameters.bevel_length * radius
    points = int(np.ceil(length / spacing)) + 1
    # In phase, a cylinder's wall adds up to sqrt(pi r / k) exp(-i pi / 4) per metre of its length.
    wall = np.sqrt(radius * beam.wavelength / 2) * np.exp(-0.25j * np.pi)
    return NeedleEcho(
        spacing=spacing,
        specular=specular * thick,
        diffuse=diffuse * thick,
        tip=points,
        taper=np.sqrt(width_left(parameters.tip, length, spacing, points)),
        piece=complex(specular * thick / spacing / wall),
        shadow=parameters.shadow,
        radius=radius,
        surface=tip_surface(
            parameters.tip,
            np.deg2rad(parameters.bevel_deg),
            radius,
            (points - 0.5) * spacing,
            beam.wavelength / _PIECES_PER_WAVELENGTH,
        ),
        phases=phases,
        pulse=pulse,
    )


def rough_phases(beam: Beam, rng: np.random.Generator) -> NDArray[np.complex128]:
    """Draw the phase factors due to the rough surface of a needle's points."""
    return np.exp(2j * np.pi * rng.random(int(8 * _LONGEST_NEEDLE / beam.wavelength)))


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
    """Smooth random field of the shaft's level along a needle and over time."""

    def __init__(self, parameters: NeedleEchoParameters, rng: np.random.Generator) -> None:
        # A sum of waves has a Gaussian correlation of these lengths.
        self._along = rng.normal(size=_WAVES) / parameters.fading_length
        self._in_time = rng.normal(size=_WAVES) / parameters.fading_period
        self._phase = rng.uniform(0, 2 * np.pi, _WAVES)
        self._level = parameters.fading_db * np.sqrt(2 / _WAVES)

    def level_db(self, from_tip: NDArray[np.float64], times: NDArray[np.float64]) -> Any:
        """Return (k, n) levels in dB at (k,) times in s and (n,) distances in m from the tip."""
        turns = np.multiply.outer(from_tip, self._along) + self._phase
        turns = turns + np.multiply.outer(times, self._in_time)[:, np.newaxis]
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
    """Return what a needle's echo depends on in every frame: angle, time and the tip's roll.

    Needles are in T at each frame's time, empty ones ignored; ``centre_offset`` is the distance in
    m from F's origin back to the array's centre of curvature.
    """
    shafts, starts = together([needle.shaft for needle in needles])
    nodes = int(np.ceil(max(needle.length for needle in needles) / _NODE)) + 2
    sine, towards = incidence(shafts, starts, X_FT, centre_offset, _NODE, nodes)
    cosine = np.sqrt(1 - sine**2)
    lobe = np.ones_like(sine)
    if parameters.diffuse_lobe_deg is not None:
        lobe = 0.5 ** ((np.rad2deg(np.arcsin(sine)) / parameters.diffuse_lobe_deg) ** 2)
    fade = np.ones_like(sine)
    if parameters.fading_db > 0:
        fade = 10 ** (fading.level_db(_NODE * np.arange(nodes, dtype=float), times) / 20)
    axes_T, turned = np.zeros((len(needles), 3, 3)), np.deg2rad(parameters.tip_roll_deg)
    for axes, needle in zip(axes_T, needles, strict=True):
        if needle:
            axes[:] = tip_axes(needle.shaft[-1] - needle.shaft[-2], needle.roll + turned)
    dimples = parameters.dimples_db
    spacing = beam.wavelength / 8
    return NeedleView(
        specular=fade * np.sqrt(cosine),
        diffuse=fade * lobe,
        cosine=cosine,
        axes=axes_T @ np.swapaxes(X_FT[:, :, :3], 1, 2),
        towards=fade[:, :1] * towards,
        points_per_node=_NODE / spacing,
        dimple=0.0 if dimples is None else float(10 ** (dimples / 20)),
        dimple_step=max(round(parameters.dimple_spacing / spacing), 1),
        dimpled=0 if dimples is None else int(parameters.dimpled_length / spacing),
    )


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
