"""A sweep of a motorised probe over tissue and needle, rendered frame by frame."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.needle.needle import Needle
from sonoservo.systems.ultrasound.beam import Beam, beam_profile
from sonoservo.systems.ultrasound.bright_echo import (
    SIDE_LOBE_LEVEL,
    SIDE_LOBE_WIDTH,
    NeedleEcho,
    render_needles,
    render_points,
)
from sonoservo.systems.ultrasound.echo import FADE, line_kernel, render_tissue
from sonoservo.systems.ultrasound.image_formation import form_image
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.projection import FRACTIONS, DepthTables, Rays
from sonoservo.systems.ultrasound.sweep import SweepGeometry
from sonoservo.systems.ultrasound.tissue import Tissue, scatterer_tile
from sonoservo.systems.ultrasound.transducer import Transducer
from sonoservo.systems.values import require, require_not_negative

_LONGEST_NEEDLE = 0.3


@dataclass(kw_only=True)
class NeedleEchoParameters:
    """How a steel needle echoes. Levels are amplitudes, where the lens focuses.

    Parameters
    ----------
    specular_db
        At normal incidence, over the tissue's root mean square.
    diffuse_db
        Of what a rough surface scatters in all directions, relative to ``specular_db``.
    tip_db
        Of the tip, over the tissue's root mean square.
    reverberation_db
        Of each echo inside the needle, relative to the one before.
    inner_diameter_ratio
        Inner over outer diameter; sets the distance between those echoes.
    shadow
        Share of the amplitude that is lost behind a needle in the middle of the beam.
    """

    specular_db: float = 38.0
    diffuse_db: float = -22.0
    tip_db: float = 26.0
    reverberation_db: float = -8.0
    inner_diameter_ratio: float = 0.66
    shadow: float = 0.45

    def __post_init__(self) -> None:
        require(
            self.reverberation_db <= -3, "reverberation_db", self.reverberation_db, "at most -3 dB"
        )
        for name in ("inner_diameter_ratio", "shadow"):
            value = getattr(self, name)
            require(0 <= value <= 1, name, value, "from 0 to 1")


@dataclass(kw_only=True)
class ScannerParameters:
    """What the image shows besides the tissue.

    Parameters
    ----------
    needle
        How a needle echoes.
    gel_thickness
        Widest gap between face and tissue that the gel bridges, along a line, in m.
    noise_db
        Electronic noise at the face, over the tissue's root mean square. It grows with depth by
        the attenuation that the time-gain compensation undoes.
    """

    needle: NeedleEchoParameters = field(default_factory=NeedleEchoParameters)
    gel_thickness: float = 3e-3
    noise_db: float = -55.0

    def __post_init__(self) -> None:
        require_not_negative(gel_thickness=self.gel_thickness)


class SweepRenderer:
    """Renders sweeps of one transducer over one tissue.

    Parameters
    ----------
    transducer, imaging
        The probe and the scanner's settings.
    tissue
        What is scanned.
    parameters
        Needle, gel and noise.
    seed
        Of the electronic noise and of the needle's surface.

    Attributes
    ----------
    geometry
        Of the sweeps.
    beam
        Widths of the point spread function.
    """

    def __init__(
        self,
        *,
        transducer: Transducer,
        imaging: ImagingParameters,
        tissue: Tissue,
        parameters: ScannerParameters,
        seed: int,
    ) -> None:
        require_not_negative(seed=seed)
        self.geometry: SweepGeometry = sweep_geometry(transducer, imaging)
        self.beam: Beam = beam_profile(transducer, imaging, self.geometry)
        self._parameters = parameters
        self._imaging = imaging
        self._seed = seed
        width, length, height = tissue.size
        self._box = np.array([[-width / 2, -length / 2, -height], [width / 2, length / 2, 0]])

        # A point is compared with the tissue at the depth where the lens focuses.
        cell = self.beam.resolution_cell
        reference = min(
            round(transducer.lens_focus / self.geometry.sample_pitch), self.geometry.samples - 1
        )
        radii = self.geometry.array_radius + self.geometry.sample_pitch * np.arange(
            self.geometry.samples
        )
        line_sigma = self.beam.lateral / (
            self.geometry.line_pitch * np.maximum(radii, self.geometry.sample_pitch)
        )
        self._tables = DepthTables(
            *(
                table.astype(np.float32)
                for table in (
                    0.5 / self.beam.elevation**2,
                    self.beam.curvature,
                    cell.min() / cell / (1 + FADE),
                    line_sigma,
                    np.sqrt(cell[reference] / cell),
                )
            )
        )
        self._kernel = line_kernel(line_sigma, self.geometry.lines)
        density = tissue.scatterers_per_cell * (1 + FADE) / (2**1.5 * cell.min())
        self._tile = scatterer_tile(density, np.random.default_rng(tissue.seed))
        # With this amplitude the tissue's mean intensity is 1 (0 dB) at every depth.
        amplitude = np.sqrt(2**1.5 / (tissue.scatterers_per_cell * (1 - FADE / 3)))
        half_taps = 2 * int(np.ceil(3 * self.beam.axial / self.geometry.sample_pitch / 2))
        self._lead = half_taps - 1
        self._taps = 2 * half_taps
        self._pulse = np.repeat(self._pulse_table([amplitude], 0.0)[0], 2, axis=1)
        self._point_pulse = self._pulse_table([1.0], 0.0)
        depth_cm = 1e2 * self.geometry.sample_pitch * np.arange(self.geometry.samples)
        loss_db = 2 * tissue.attenuation * 1e-6 * imaging.transmit_frequency * depth_cm
        self._noise = (10 ** ((parameters.noise_db + loss_db) / 20)).astype(np.float32)
        self._needle_echo = self._needle_points(reference)
        self._inclusions = self._inclusion_points(tissue, reference)
        self._last: dict[int, tuple[bytes, NDArray[np.complex64]]] = {}
        self._lines = {direction: self._line_rays(direction) for direction in (1, -1)}

    def tissue_echo(self, X_TP: NDArray[np.float64], direction: int) -> NDArray[np.complex64]:
        """Echoes of tissue and inclusions, without needle or noise.

        Parameters
        ----------
        X_TP
            (frames, 4, 4) pose of the probe in the tissue at each frame's time.
        direction
            +1 for a sweep towards +Z, -1 towards -Z.

        Returns
        -------
        (frames, lines, samples) amplitudes at the transmit frequency; the tissue's mean intensity
        is 1 at every depth.
        """
        iq = np.empty(self.geometry.shape, np.complex64)
        X_FT = self._frame_poses(X_TP)
        rays = self._rays(direction)
        tile, tables = self._tile, self._tables
        render_tissue(iq, X_FT, self._box, tile, rays, tables, self._pulse, self._kernel)
        if len(self._inclusions[0]):
            render_points(iq, X_FT, *self._inclusions, rays, tables, self._point_pulse)
        return iq

    def echo(
        self, X_TP: NDArray[np.float64], needles: Sequence[Needle], direction: int
    ) -> NDArray[np.complex64]:
        """Echoes with the needle and its shadow, without noise; otherwise as `tissue_echo`.

        Parameters
        ----------
        X_TP, direction
            See `tissue_echo`.
        needles
            The needle in T at each frame's time, possibly empty.
        """
        # Rounded to 10 nm, 0.0003 rad of phase, so that a probe at rest finds its echoes again.
        X_TP = np.round(X_TP, 8)
        key, echo = self._last.get(direction, (b"", None))
        if echo is None or key != X_TP.tobytes():
            echo = self.tissue_echo(X_TP, direction)
            self._last[direction] = X_TP.tobytes(), echo
        if not any(needles):
            return echo
        iq = echo.copy()
        radius = needles[0].radius
        render_needles(
            iq,
            self._frame_poses(X_TP),
            np.concatenate([needle.shaft for needle in needles]),
            np.concatenate([[0], np.cumsum([len(needle.shaft) for needle in needles])]),
            radius,
            *self._needle_echo,
            self._rays(direction),
            self._tables,
            self._needle_pulse(radius),
        )
        return iq

    def render(
        self,
        X_TP: NDArray[np.float64],
        needles: Sequence[Needle],
        direction: int,
        number: int,
    ) -> NDArray[np.uint8]:
        """Grey levels of a sweep, (frames, lines, samples).

        Parameters
        ----------
        X_TP, needles, direction
            See `echo`.
        number
            Of the sweep; it selects the noise.
        """
        grey = np.empty(self.geometry.shape, np.uint8)
        form_image(
            grey,
            self.echo(X_TP, needles, direction),
            np.ascontiguousarray(X_TP[:, :3]),
            self._box,
            *self._lines[direction],
            self._parameters.gel_thickness,
            self._noise,
            np.random.SeedSequence([self._seed, number]).generate_state(len(grey), np.uint64),
            self._imaging.grey_per_db,
            self._imaging.tissue_grey,
        )
        return grey

    def _rays(self, direction: int) -> Rays:
        geometry = self.geometry
        steps = geometry.frames * geometry.lines - 1
        return Rays(
            array_radius=np.float32(geometry.array_radius),
            centre_offset=np.float32(geometry.array_radius - geometry.motor_radius),
            lines_per_radian=np.float32(1 / geometry.line_pitch),
            middle_line=np.float32((geometry.lines - 1) / 2),
            twist=np.float32(direction * geometry.frame_pitch * geometry.frames / steps),
            samples_per_metre=np.float32(1 / geometry.sample_pitch),
            turns_per_metre=np.float32(2 / self.beam.wavelength),
            lead=self._lead,
        )

    def _frame_poses(self, X_TP: NDArray[np.float64]) -> NDArray[np.float64]:
        """(frames, 3, 4) pose of the tissue in each frame's F."""
        geometry = self.geometry
        require(X_TP.shape == (geometry.frames, 4, 4), "X_TP", X_TP.shape, "(frames, 4, 4)")
        theta = geometry.line_angles(1).mean(axis=1)
        X_FP = np.zeros((geometry.frames, 4, 4))
        X_FP[:, 0, 0] = X_FP[:, 3, 3] = 1
        X_FP[:, 1, 1] = X_FP[:, 2, 2] = np.cos(theta)
        X_FP[:, 1, 2] = np.sin(theta)
        X_FP[:, 2, 1] = -np.sin(theta)
        X_FP[:, :, 3] += X_FP[:, :, 1] * geometry.motor_radius
        return np.ascontiguousarray((X_FP @ np.linalg.inv(X_TP))[:, :3])

    def _line_rays(self, direction: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(frames, lines, 3) origin on the face and unit direction of every line, in P."""
        frames, lines, _ = np.ogrid[: self.geometry.frames, : self.geometry.lines, :1]
        start = self.geometry.position(frames, lines, 0, direction)[:, :, 0]
        along = self.geometry.position(frames, lines, 1, direction)[:, :, 0] - start
        return start, along / self.geometry.sample_pitch

    def _pulse_table(self, levels: Sequence[float], distance: float) -> NDArray[np.float32]:
        """Echoes of given amplitudes at multiples of a distance: (2, FRACTIONS + 1, taps)."""
        pitch = self.geometry.sample_pitch
        taps = self._taps + int(np.ceil((len(levels) - 1) * distance / pitch))
        fraction = np.arange(FRACTIONS + 1)[:, np.newaxis] / FRACTIONS
        path = (np.arange(taps) - self._lead - fraction) * pitch
        table = np.zeros(path.shape, complex)
        for number, level in enumerate(levels):
            behind = path - number * distance
            phase = -4 * np.pi * number * distance / self.beam.wavelength
            table += level * np.exp(1j * phase - behind**2 / (2 * self.beam.axial**2))
        return np.stack([table.real, table.imag]).astype(np.float32)

    @lru_cache(maxsize=8)  # noqa: B019 - a renderer lives as long as its scanner
    def _needle_pulse(self, radius: float) -> NDArray[np.float32]:
        """Pulse and its reverberations in water inside a needle."""
        needle = self._parameters.needle
        ratio = 10 ** (needle.reverberation_db / 20)
        count = 1 + int(-40 / needle.reverberation_db)
        distance = 2 * radius * needle.inner_diameter_ratio * 1540 / 1480
        return self._pulse_table([ratio**number for number in range(count)], distance)

    def _rod(
        self, level_db: float, diffuse_db: float, reference: int
    ) -> tuple[float, float, float]:
        """Spacing, specular and diffuse amplitude of the points of a thin rod."""
        spacing = self.beam.wavelength / 8
        width = self.beam.lateral[reference]
        # The side lobes add to what a long smooth rod sends back.
        length = np.sqrt(2 * np.pi) * width * (1 + SIDE_LOBE_LEVEL * SIDE_LOBE_WIDTH)
        specular = 10 ** (level_db / 20) * spacing / length
        diffuse = 10 ** ((level_db + diffuse_db) / 20) * np.sqrt(spacing / (np.sqrt(np.pi) * width))
        return spacing, specular, diffuse

    def _needle_points(self, reference: int) -> tuple[NeedleEcho, NDArray[np.float64]]:
        needle = self._parameters.needle
        spacing, specular, diffuse = self._rod(needle.specular_db, needle.diffuse_db, reference)
        echo = NeedleEcho(spacing, specular, diffuse, 10 ** (needle.tip_db / 20), needle.shadow)
        rng = np.random.default_rng([self._seed, 1])
        return echo, rng.uniform(0, 2 * np.pi, int(_LONGEST_NEEDLE / spacing))

    def _inclusion_points(
        self, tissue: Tissue, reference: int
    ) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """(n, 3) positions in T and (n,) amplitudes."""
        rng = np.random.default_rng([tissue.seed, 1])
        points = [np.zeros((0, 3))]
        amplitudes = [np.zeros(0, complex)]
        cell = self.beam.resolution_cell[reference]
        for ball in tissue.balls:
            density = 8 / (2**1.5 * cell)
            count = max(round(density * 4 / 3 * np.pi * ball.radius**3), 8)
            offsets = rng.normal(size=(count, 3))
            offsets *= (
                ball.radius
                * np.cbrt(rng.random((count, 1)))
                / np.linalg.norm(offsets, axis=1, keepdims=True)
            )
            level = 10 ** (ball.level_db / 20) / np.sqrt(density * cell)
            points.append(offsets + ball.centre)
            amplitudes.append(level * np.exp(2j * np.pi * rng.random(count)))
        for fibre in tissue.fibres:
            spacing, specular, diffuse = self._rod(fibre.level_db, fibre.diffuse_db, reference)
            start, end = np.array(fibre.start), np.array(fibre.end)
            along = np.arange(0, 1, spacing / np.linalg.norm(end - start))[:, np.newaxis]
            points.append(start + along * (end - start))
            amplitudes.append(specular + diffuse * np.exp(2j * np.pi * rng.random(len(along))))
        return np.concatenate(points), np.concatenate(amplitudes)
