"""Renderer of sweeps of a motorised probe over tissue and needle."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.signals.requirements import require, require_not_negative
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam, beam_profile, point_spread
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.simulation.air_pockets import AirPockets
from sonoservo.systems.ultrasound.simulation.kernels.bright_echo import (
    NO_TRANSMISSION,
    render_points,
)
from sonoservo.systems.ultrasound.simulation.kernels.displacement import (
    NO_DISPLACEMENTS,
    Displacements,
)
from sonoservo.systems.ultrasound.simulation.kernels.echo import FADE, render_tissue
from sonoservo.systems.ultrasound.simulation.kernels.image_formation import form_image, modulate
from sonoservo.systems.ultrasound.simulation.kernels.line_blur import line_kernel
from sonoservo.systems.ultrasound.simulation.kernels.medium import expand_gains
from sonoservo.systems.ultrasound.simulation.kernels.surface_echo import render_surfaces
from sonoservo.systems.ultrasound.simulation.needle_echo import NeedleEchoParameters
from sonoservo.systems.ultrasound.simulation.needle_renderer import FrameViews, NeedleRenderer
from sonoservo.systems.ultrasound.simulation.pulses import PulseTables
from sonoservo.systems.ultrasound.simulation.rays import (
    depth_tables,
    frame_poses,
    line_rays,
    projection_rays,
)
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation, displacements
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.simulation.scatterer_tile import scatterer_tile
from sonoservo.systems.ultrasound.simulation.scatterers.bright_points import inclusion_points
from sonoservo.systems.ultrasound.simulation.scene import Scene
from sonoservo.systems.ultrasound.simulation.structures.resting_needle import RestingNeedle
from sonoservo.systems.ultrasound.simulation.tissue import Tissue
from sonoservo.systems.ultrasound.transducer import Transducer


class SweepRenderer:
    """Renders sweeps of one transducer over one tissue.

    It models the motion of probe, tissue and needle and the tissue's deformation within a sweep,
    down to the phase of every scatterer; the depth-dependent width of the beam in all directions;
    side lobes, reverberation and shadow of the needle; structures and anatomy with their surfaces,
    shadows and attenuation; wrong speeds of sound, and a refracting layer of fat; a curved skin,
    loss of contact and air pockets; attenuation, as noise; and log compression. It does not model
    refraction elsewhere, how deformation moves other attenuation or speeds, the effect of speeds on
    the focus, multiple scattering other than between a surface and the face, the loss of beam at
    the array's ends or, along it, wave fronts not centred on its own centre.

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
    parameters, seed
        See above.
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
        self.decibels_per_level = imaging.decibels_per_level
        self.parameters, self._imaging, self.seed = parameters, imaging, seed
        self._box = tissue.surface.bounds
        sound_speed = tissue.sound_speed or imaging.sound_speed
        # Samples are times; lengths in the tissue follow from its own speed of sound.
        ratio = sound_speed / imaging.sound_speed
        geometry = self.geometry
        if ratio != 1:
            pitch = geometry.sample_pitch * ratio
            geometry = replace(geometry, sample_pitch=pitch, sound_speed=sound_speed)
            imaging = replace(imaging, sound_speed=sound_speed)
        self._acoustic = geometry
        self.beam: Beam = beam_profile(transducer, imaging, geometry)
        self.point_spread: PointSpread = point_spread(self.beam, self.geometry)

        depths = geometry.sample_pitch * np.arange(geometry.samples)
        cell = self.beam.resolution_cell
        reference = int(np.abs(depths - transducer.lens_focus).argmin())
        self._tables, line_sigma = depth_tables(self.beam, geometry, reference)
        self._kernel = line_kernel(line_sigma, geometry.lines)
        density = tissue.scatterers_per_cell * (1 + FADE) / (2**1.5 * cell.min())
        self._tile = scatterer_tile(density, np.random.default_rng(tissue.seed))
        self._inclusions = inclusion_points(tissue, self.beam, reference)
        pulses = PulseTables(self.beam, geometry.sample_pitch)

        def needle_renderer(echo: NeedleEchoParameters, seeds: Sequence[int]) -> NeedleRenderer:
            return NeedleRenderer(echo, self.beam, geometry, reference, pulses, seeds)

        self._needle = needle_renderer(parameters.needle, [seed, 1])
        self._resting = [
            (each.needle(), needle_renderer(each.echo, [tissue.seed, 3, number]))
            for number, each in enumerate(tissue.structures)
            if isinstance(each, RestingNeedle)
        ]
        # With this amplitude the tissue's mean intensity is 1 (0 dB) at every depth.
        amplitude = np.sqrt(2**1.5 / (tissue.scatterers_per_cell * (1 - FADE / 3)))
        self._tissue_pulse = np.repeat(pulses.tabulate([amplitude], [0.0])[0], 2, axis=1)
        self._point_pulse = pulses.tabulate([1.0], [0.0])
        self._scene = Scene(
            tissue,
            beam=self.beam,
            geometry=geometry,
            reference=reference,
            pulses=pulses,
            block_size=self._tile.block_size,
            sound_speed=sound_speed,
            frequency=imaging.transmit_frequency,
        )
        loss_db = 2 * tissue.attenuation * 1e-6 * imaging.transmit_frequency * 1e2 * depths
        self._noise = (10 ** ((parameters.noise_db + loss_db) / 20)).astype(np.float32)
        rng = np.random.default_rng([seed, 4])
        air = parameters.air_pockets
        self._air = AirPockets(air, transducer, imaging, self.geometry, rng)
        self._lines = {direction: line_rays(geometry, direction) for direction in (1, -1)}
        self._rays = {d: projection_rays(geometry, self.beam, d, pulses.lead) for d in (1, -1)}
        # Sweep-sized memory is allocated once: tissue echoes in both directions, and needle echoes.
        self._tissue = {direction: self._empty() for direction in (1, -1)}
        self._views: dict[int, FrameViews] = {}
        self._tissue_keys = {1: b"", -1: b""}
        self._with_needle = self._empty()

    def tissue_echo(
        self,
        X_TP: NDArray[np.float64],
        direction: int,
        times: NDArray[np.float64] | None = None,
        deformations: Sequence[Deformation] | None = None,
    ) -> NDArray[np.complex64]:
        """Return the echoes of the tissue and its contents, without the moving needle or noise.

        Parameters
        ----------
        X_TP
            (frames, 4, 4) pose of the probe in the tissue at each frame's time.
        direction
            +1 for a sweep towards +Z, -1 towards -Z.
        times
            (frames,) times in s, for pulsation, flow and fading; None for 0.
        deformations
            Deformation of the tissue at each frame's time; None for undeformed tissue.

        Returns
        -------
        (frames, lines, samples) amplitudes at the transmit frequency; the tissue's mean intensity
        is 1 at every depth.
        """
        iq, times = self._empty(), np.zeros(len(X_TP)) if times is None else times
        self._render_tissue(iq, X_TP, direction, times, displacements(deformations))
        return iq

    def echo(
        self,
        X_TP: NDArray[np.float64],
        needles: Sequence[Needle],
        direction: int,
        times: NDArray[np.float64] | None = None,
        deformations: Sequence[Deformation] | None = None,
    ) -> NDArray[np.complex64]:
        """Return the echoes with the needle and its shadow, without noise, as `tissue_echo` does.

        Parameters
        ----------
        X_TP, direction, times, deformations
            See `tissue_echo`.
        needles
            True needle in T at each frame's time, possibly empty.
        """
        return self._render_echo(X_TP, needles, direction, times, deformations).copy()

    def radio_frequency_lines(
        self,
        X_TP: NDArray[np.float64],
        needles: Sequence[Needle],
        direction: int,
        times: NDArray[np.float64] | None = None,
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
        return self.on_carrier(self._render_echo(X_TP, needles, direction, times))

    def on_carrier(self, iq: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return the radio-frequency lines of echoes; see `radio_frequency_lines`."""
        step = 4 * np.pi / self.beam.wavelength * self._acoustic.sample_pitch
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
            See `tissue_echo`; the tissue is not deformed.
        points, amplitudes
            (n, 3) positions in T, in m, and (n,) amplitudes relative to the tissue's at the focus.
        """
        X_FT, rays = frame_poses(self._acoustic, X_TP), self._rays[direction]
        view, *_ = self._scene.view(X_FT, float(rays.twist))
        beams = (rays, self._tables, self._point_pulse, view, NO_DISPLACEMENTS)
        render_points(iq, X_FT, points, amplitudes, *beams)

    def render(
        self,
        X_TP: NDArray[np.float64],
        needles: Sequence[Needle],
        direction: int,
        number: int,
        times: NDArray[np.float64] | None = None,
        deformations: Sequence[Deformation] | None = None,
    ) -> NDArray[np.uint8]:
        """Return the grey levels of a sweep, (frames, lines, samples).

        Parameters
        ----------
        X_TP, needles, direction, times, deformations
            See `echo`.
        number
            Number of the sweep, which selects the noise.
        """
        grey = np.empty(self.geometry.shape, np.uint8)
        open_shares = self._air.open_shares(np.zeros(len(grey)) if times is None else times)
        form_image(
            grey,
            self._render_echo(X_TP, needles, direction, times, deformations),
            np.ascontiguousarray(X_TP[:, :3]),
            self._box,
            *self._lines[direction],
            self.parameters.gel_thickness,
            open_shares,
            self._noise,
            np.random.SeedSequence([self.seed, number]).generate_state(len(grey), np.uint64),
            self._imaging.grey_per_db,
            self._imaging.tissue_grey,
        )
        return grey

    def _empty(self) -> NDArray[np.complex64]:
        return np.empty(self.geometry.shape, np.complex64)

    def _render_tissue(
        self,
        iq: NDArray[np.complex64],
        X_TP: NDArray[np.float64],
        direction: int,
        times: NDArray[np.float64],
        field: Displacements,
    ) -> FrameViews:
        """Render everything except the needle; return the views needed for the needle's echo."""
        X_FT, rays = frame_poses(self._acoustic, X_TP), self._rays[direction]
        scene, tables = self._scene, self._tables
        view, gains, nodes_per_metre = scene.view(X_FT, float(rays.twist))
        medium = (self._tissue_pulse, self._kernel, scene.regions, scene.lumens(times), view, field)
        render_tissue(iq, X_FT, self._box, self._tile, rays, tables, *medium)
        if len(self._inclusions[0]):
            points = (*self._inclusions, rays, tables, self._point_pulse, view, field)
            render_points(iq, X_FT, *points)
        transmission = NO_TRANSMISSION
        if scene.pieces is not None:
            transmission = np.ones(self.geometry.shape, np.float32)
            if gains is not None:
                expand_gains(transmission, gains, nodes_per_metre * self._acoustic.sample_pitch)
            parts = (scene.pieces, scene.growth(times), rays, tables, scene.pulses, scene.taps)
            render_surfaces(iq, transmission, X_FT, *parts, view, field, gains is not None)
        views = FrameViews(X_FT, rays, tables, view, transmission, times)
        for needle, renderer in self._resting:
            renderer.add_resting(iq, needle, field, views)
        return views

    def _render_echo(
        self,
        X_TP: NDArray[np.float64],
        needles: Sequence[Needle],
        direction: int,
        times: NDArray[np.float64] | None,
        deformations: Sequence[Deformation] | None = None,
    ) -> NDArray[np.complex64]:
        """Return the echoes as `echo` does, in memory that the next call overwrites."""
        times = np.zeros(len(X_TP)) if times is None else times
        # Rounded to 10 nm, or 0.0003 rad of phase, so that a probe at rest reuses its echoes.
        X_TP = np.round(X_TP, 8)
        tissue = self._tissue[direction]
        key = X_TP.tobytes() + (times.tobytes() if self._varies else b"")
        field = displacements(deformations)
        key += b"".join(np.asarray(each).tobytes() for each in field)
        if self._tissue_keys[direction] != key:
            self._views[direction] = self._render_tissue(tissue, X_TP, direction, times, field)
            self._tissue_keys[direction] = key
        if not any(needles):
            return tissue
        iq = self._with_needle
        np.copyto(iq, tissue)
        self._needle.add(iq, needles, self._views[direction]._replace(times=times))
        return iq

    @property
    def _varies(self) -> bool:
        """True if the image of a scene at rest changes over time."""
        return self._scene.varies or any(renderer.varies for _, renderer in self._resting)
