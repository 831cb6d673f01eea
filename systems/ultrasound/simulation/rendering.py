"""Renderer of sweeps of a motorised probe over tissue and needle."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.signals.requirements import require, require_not_negative
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam, beam_profile, point_spread
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.simulation.bright_points import (
    NeedleEchoParameters,
    inclusion_points,
    needle_echo,
    reverberations,
)
from sonoservo.systems.ultrasound.simulation.kernels.bright_echo import (
    render_needles,
    render_points,
)
from sonoservo.systems.ultrasound.simulation.kernels.echo import FADE, render_tissue
from sonoservo.systems.ultrasound.simulation.kernels.image_formation import form_image, modulate
from sonoservo.systems.ultrasound.simulation.kernels.line_blur import line_kernel
from sonoservo.systems.ultrasound.simulation.kernels.projection import FRACTIONS, DepthTables
from sonoservo.systems.ultrasound.simulation.rays import frame_poses, line_rays, projection_rays
from sonoservo.systems.ultrasound.simulation.tissue import Tissue, scatterer_tile
from sonoservo.systems.ultrasound.transducer import Transducer


@dataclass(kw_only=True)
class ScannerParameters:
    """Parameters of the needle's echo, the gel and the electronic noise.

    Parameters
    ----------
    needle
        Parameters of the needle's echo.
    gel_thickness
        Widest gap between face and tissue that the gel bridges, along a line, in m.
    noise_db
        Electronic noise at the face, relative to the tissue's root mean square. It grows with depth
        by the attenuation that the time-gain compensation undoes.
    """

    needle: NeedleEchoParameters = field(default_factory=NeedleEchoParameters)
    gel_thickness: float = 3e-3
    noise_db: float = -55.0

    def __post_init__(self) -> None:
        require_not_negative(gel_thickness=self.gel_thickness)


class SweepRenderer:
    """Renders sweeps of one transducer over one tissue.

    It models the motion of probe, tissue and needle within a sweep, down to the phase of every
    scatterer; the depth-dependent width of the beam in all directions; side lobes, reverberation
    and shadow of the needle; loss of contact; attenuation, as noise; and log compression. It does
    not model refraction, multiple scattering, the loss of beam at the ends of the array or, along
    the array, wave fronts that are not centred on the array's own centre.

    Parameters
    ----------
    transducer, imaging
        Hardware of the probe, and settings of the scanner.
    tissue
        Tissue to scan.
    parameters
        Parameters of needle, gel and noise.
    seed
        Seed of the electronic noise and of the needle's surface.

    Attributes
    ----------
    geometry
        Geometry of the sweeps.
    beam
        Widths of the point spread function.
    point_spread
        The same widths, in the form that sweeps carry.
    decibels_per_level
        Scale of the image, in dB per grey level.
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
        self.point_spread: PointSpread = point_spread(self.beam, self.geometry)
        self.decibels_per_level = imaging.decibels_per_level
        self._parameters = parameters
        self._imaging = imaging
        self._seed = seed
        width, length, height = tissue.size
        self._box = np.array([[-width / 2, -length / 2, -height], [width / 2, length / 2, 0]])

        samples = np.arange(self.geometry.samples)
        depths = self.geometry.sample_pitch * samples
        cell = self.beam.resolution_cell
        # Sample at which the levels of bright points hold, relative to the tissue.
        reference = int(np.abs(depths - transducer.lens_focus).argmin())
        radii = np.maximum(self.geometry.array_radius + depths, self.geometry.sample_pitch)
        line_sigma = self.beam.lateral / (self.geometry.line_pitch * radii)
        self._tables = DepthTables(
            elevation_precision=(0.5 / self.beam.elevation**2).astype(np.float32),
            curvature=self.beam.curvature.astype(np.float32),
            share=(cell.min() / cell / (1 + FADE)).astype(np.float32),
            line_sigma=line_sigma.astype(np.float32),
            bright=np.sqrt(cell[reference] / cell).astype(np.float32),
        )
        self._kernel = line_kernel(line_sigma, self.geometry.lines)
        density = tissue.scatterers_per_cell * (1 + FADE) / (2**1.5 * cell.min())
        self._tile = scatterer_tile(density, np.random.default_rng(tissue.seed))
        self._inclusions = inclusion_points(tissue, self.beam, reference)
        self._needle_echo = needle_echo(
            parameters.needle, self.beam, reference, np.random.default_rng([seed, 1])
        )

        half_taps = 2 * int(np.ceil(3 * self.beam.axial / self.geometry.sample_pitch / 2))
        self._lead = half_taps - 1
        self._taps = 2 * half_taps
        # With this amplitude the tissue's mean intensity is 1 (0 dB) at every depth.
        amplitude = np.sqrt(2**1.5 / (tissue.scatterers_per_cell * (1 - FADE / 3)))
        self._tissue_pulse = np.repeat(self._pulse_table([amplitude], 0.0)[0], 2, axis=1)
        self._point_pulse = self._pulse_table([1.0], 0.0)
        self._needle_pulses = lru_cache(maxsize=8)(self._needle_pulse)
        loss_db = 2 * tissue.attenuation * 1e-6 * imaging.transmit_frequency * 1e2 * depths
        self._noise = (10 ** ((parameters.noise_db + loss_db) / 20)).astype(np.float32)
        self._lines = {each: line_rays(self.geometry, each) for each in (1, -1)}
        self._rays = {
            each: projection_rays(self.geometry, self.beam, each, self._lead) for each in (1, -1)
        }
        # Sweep-sized memory is allocated once: tissue echoes in both directions, and needle echoes.
        self._tissue = {direction: self._empty() for direction in (1, -1)}
        self._tissue_poses = {1: b"", -1: b""}
        self._with_needle = self._empty()

    def tissue_echo(self, X_TP: NDArray[np.float64], direction: int) -> NDArray[np.complex64]:
        """Return the echoes of tissue and inclusions, without needle or noise.

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
        iq = self._empty()
        self._render_tissue(iq, X_TP, direction)
        return iq

    def echo(
        self, X_TP: NDArray[np.float64], needles: Sequence[Needle], direction: int
    ) -> NDArray[np.complex64]:
        """Return the echoes with the needle and its shadow, without noise, as `tissue_echo` does.

        Parameters
        ----------
        X_TP, direction
            See `tissue_echo`.
        needles
            Needle in T at each frame's time, possibly empty.
        """
        return self._render_echo(X_TP, needles, direction).copy()

    def radio_frequency_lines(
        self, X_TP: NDArray[np.float64], needles: Sequence[Needle], direction: int
    ) -> NDArray[np.float32]:
        """Return radio-frequency lines, (frames, lines, samples): `echo` on its carrier.

        They are the real part of echo exp(+2i k r) with k = 2 pi / wavelength and the distance r
        from the face, without noise. The sample pitch must resolve the carrier.

        Raises
        ------
        ValueError
            If the sample pitch is a quarter of the wavelength or more.
        """
        pitch, wavelength = self.geometry.sample_pitch, self.beam.wavelength
        require(
            pitch < wavelength / 4, "sample_pitch", pitch, f"below a quarter of {wavelength:g} m"
        )
        return self.on_carrier(self._render_echo(X_TP, needles, direction))

    def on_carrier(self, iq: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return the radio-frequency lines of echoes; see `radio_frequency_lines`."""
        step = 4 * np.pi / self.beam.wavelength * self.geometry.sample_pitch
        phase = step * np.arange(self.geometry.samples)
        lines = np.empty(iq.shape, np.float32)
        modulate(lines, iq, np.cos(phase).astype(np.float32), np.sin(phase).astype(np.float32))
        return lines

    def add_scatterers(
        self,
        iq: NDArray[np.complex64],
        X_TP: NDArray[np.float64],
        points: NDArray[np.float64],
        amplitudes: NDArray[np.complex128],
        direction: int,
    ) -> None:
        """Add the echoes of point scatterers to `echo`'s, in place.

        Parameters
        ----------
        iq
            (frames, lines, samples) echoes.
        X_TP, direction
            See `tissue_echo`.
        points, amplitudes
            (n, 3) positions in T, in m, and (n,) amplitudes relative to the tissue's root mean
            square at the lens's focus.
        """
        X_FT, rays = frame_poses(self.geometry, X_TP), self._rays[direction]
        render_points(iq, X_FT, points, amplitudes, rays, self._tables, self._point_pulse)

    def render(
        self,
        X_TP: NDArray[np.float64],
        needles: Sequence[Needle],
        direction: int,
        number: int,
    ) -> NDArray[np.uint8]:
        """Return the grey levels of a sweep, (frames, lines, samples).

        Parameters
        ----------
        X_TP, needles, direction
            See `echo`.
        number
            Number of the sweep, which selects the noise.
        """
        grey = np.empty(self.geometry.shape, np.uint8)
        form_image(
            grey,
            self._render_echo(X_TP, needles, direction),
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

    def _empty(self) -> NDArray[np.complex64]:
        return np.empty(self.geometry.shape, np.complex64)

    def _render_tissue(
        self, iq: NDArray[np.complex64], X_TP: NDArray[np.float64], direction: int
    ) -> None:
        X_FT = frame_poses(self.geometry, X_TP)
        rays = self._rays[direction]
        tile, tables = self._tile, self._tables
        render_tissue(iq, X_FT, self._box, tile, rays, tables, self._tissue_pulse, self._kernel)
        if len(self._inclusions[0]):
            render_points(iq, X_FT, *self._inclusions, rays, tables, self._point_pulse)

    def _render_echo(
        self, X_TP: NDArray[np.float64], needles: Sequence[Needle], direction: int
    ) -> NDArray[np.complex64]:
        """Return the echoes as `echo` does, in memory that the next call overwrites."""
        # Rounded to 10 nm, or 0.0003 rad of phase, so that a probe at rest reuses its echoes.
        X_TP = np.round(X_TP, 8)
        tissue = self._tissue[direction]
        if self._tissue_poses[direction] != X_TP.tobytes():
            self._render_tissue(tissue, X_TP, direction)
            self._tissue_poses[direction] = X_TP.tobytes()
        if not any(needles):
            return tissue
        iq = self._with_needle
        np.copyto(iq, tissue)
        radius = needles[0].radius
        render_needles(
            iq,
            frame_poses(self.geometry, X_TP),
            np.concatenate([needle.shaft for needle in needles]),
            np.concatenate([[0], np.cumsum([len(needle.shaft) for needle in needles])]),
            radius,
            *self._needle_echo,
            self._rays[direction],
            self._tables,
            self._needle_pulses(radius),
        )
        return iq

    def _needle_pulse(self, radius: float) -> NDArray[np.float32]:
        """Return the pulse with the reverberations inside a needle of this radius."""
        levels, distance = reverberations(
            self._parameters.needle, radius, self.geometry.sound_speed
        )
        return self._pulse_table(levels, distance)

    def _pulse_table(self, levels: Sequence[float], distance: float) -> NDArray[np.float32]:
        """Return a (2, FRACTIONS + 1, taps) pulse with echoes at multiples of a distance."""
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
