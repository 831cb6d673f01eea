"""Renderer of successive frames of a motorised probe over tissue and needle."""

import operator
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam, beam_profile
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.simulation.air_pockets import AirPockets
from sonoservo.systems.ultrasound.simulation.haze import gain_errors, speckle_field
from sonoservo.systems.ultrasound.simulation.kernels.blocks import scatterer_tile
from sonoservo.systems.ultrasound.simulation.kernels.bright_echo import render_points
from sonoservo.systems.ultrasound.simulation.kernels.displacement import Displacements
from sonoservo.systems.ultrasound.simulation.kernels.echo import (
    FADE,
    Scattering,
    render_tissue,
)
from sonoservo.systems.ultrasound.simulation.kernels.image_formation import (
    Acquired,
    Console,
    form_image,
)
from sonoservo.systems.ultrasound.simulation.kernels.layers import expand_gains
from sonoservo.systems.ultrasound.simulation.kernels.line_blur import line_kernel
from sonoservo.systems.ultrasound.simulation.kernels.medium import Sights
from sonoservo.systems.ultrasound.simulation.kernels.surface_echo import render_surfaces
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import NeedleEchoParameters
from sonoservo.systems.ultrasound.simulation.needles.needle_renderer import (
    FrameViews,
    NeedleRenderer,
)
from sonoservo.systems.ultrasound.simulation.pulses import (
    PulseTables,
    frame_poses,
    line_rays,
    line_widths,
    motor_poses,
    projection_rays,
)
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation, displacements
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.simulation.scatterers import inclusion_points
from sonoservo.systems.ultrasound.simulation.scene import Scene
from sonoservo.systems.ultrasound.simulation.structures.kinds import RestingNeedle
from sonoservo.systems.ultrasound.simulation.tissue import Tissue
from sonoservo.systems.ultrasound.transducer import Transducer


@dataclass(frozen=True, eq=False)
class Frames:
    """Successive frames of a sweep, with the true state of the world at each frame's time.

    ``part`` has their numbers, towards +Z whatever the direction of the sweep; see
    `SweepRenderer.echo`.
    """

    part: slice
    direction: int
    X_TP: NDArray[np.float64]
    times: NDArray[np.float64]
    needles: Sequence[Needle]
    deformations: Sequence[Deformation] | None = None

    def among(self, part: slice) -> "Frames":
        """Return some of the frames of a whole sweep."""
        deformations = self.deformations
        return Frames(
            part,
            self.direction,
            self.X_TP[part],
            self.times[part],
            self.needles[part],
            None if deformations is None else deformations[part],
        )

    def equals(self, other: "Frames") -> bool:
        """Return True if these are the same frames of the same world."""
        return (
            (self.part, self.direction) == (other.part, other.direction)
            and np.array_equal(self.X_TP, other.X_TP)
            and np.array_equal(self.times, other.times)
            and _identical(self.needles, other.needles)
            and _identical(self.deformations or (), other.deformations or ())
        )


def _identical(these: Sequence[object], those: Sequence[object]) -> bool:
    return len(these) == len(those) and all(map(operator.is_, these, those))


class FrameRenderer:
    """Renders frames of one transducer over one tissue; see `SweepRenderer` for what it models.

    It has no state, so threads may share it. ``acoustic`` is the geometry with lengths in the
    tissue, which has a speed of sound of its own.
    """

    def __init__(
        self,
        transducer: Transducer,
        imaging: ImagingParameters,
        tissue: Tissue,
        parameters: ScannerParameters,
        seed: int,
    ) -> None:
        self.geometry: SweepGeometry = sweep_geometry(transducer, imaging)
        self._parameters, self._seed = parameters, seed
        sound_speed = tissue.sound_speed or imaging.sound_speed
        # Samples are times; lengths in the tissue follow from its own speed of sound.
        ratio = sound_speed / imaging.sound_speed
        geometry = self.geometry
        if ratio != 1:
            pitch = geometry.sample_pitch * ratio
            geometry = replace(geometry, sample_pitch=pitch, sound_speed=sound_speed)
            imaging = replace(imaging, sound_speed=sound_speed)
        self.acoustic = geometry
        self.beam: Beam = beam_profile(transducer, imaging, geometry)

        depths = geometry.sample_pitch * np.arange(geometry.samples)
        cell = self.beam.resolution_cell
        reference = int(np.abs(depths - transducer.lens_focus).argmin())
        density = tissue.scatterers_per_cell * (1 + FADE) / (2**1.5 * cell.min())
        tile = scatterer_tile(density, np.random.default_rng(tissue.seed))
        self._inclusions = inclusion_points(tissue, self.beam, reference)
        pulses = PulseTables(self.beam, geometry.sample_pitch)

        def needle_renderer(echo: NeedleEchoParameters, seeds: Sequence[int]) -> NeedleRenderer:
            return NeedleRenderer(echo, self.beam, geometry, reference, pulses, seeds)

        self._needle = needle_renderer(parameters.needle, [seed, 1])
        # A channel of bubbles and torn tissue scatters in all directions and lets sound through.
        track = NeedleEchoParameters(
            specular_db=-300.0, diffuse_db=300 + parameters.track_db, diffuse_lobe_deg=None,
            tip="blunt", reverberation_db=-300.0, shadow=0.0,
        )  # fmt: skip
        self._track = needle_renderer(track, [seed, 7])
        self._resting = [
            (each.needle(), needle_renderer(each.echo, [tissue.seed, 3, number]))
            for number, each in enumerate(tissue.structures)
            if isinstance(each, RestingNeedle)
        ]
        # With this amplitude, mean intensity 1 (0 dB) is that of the tissue at every depth.
        amplitude = np.sqrt(2**1.5 / (tissue.scatterers_per_cell * (1 - FADE / 3)))
        amplitude *= 10 ** (tissue.level_db / 20)
        self._point_pulse = pulses.tabulate([1.0], [0.0])
        self._scene = Scene(
            tissue,
            beam=self.beam,
            geometry=geometry,
            reference=reference,
            pulses=pulses,
            block_size=tile.block_size,
            sound_speed=sound_speed,
            frequency=imaging.transmit_frequency,
        )
        self._scattering = Scattering(
            box=tissue.surface.bounds,
            tile=tile,
            regions=self._scene.regions,
            pulse=np.repeat(pulses.tabulate([amplitude], [0.0])[:, ::2], 2, axis=1),
            kernel=line_kernel(line_widths(geometry, self.beam), geometry.lines),
        )
        loss_db = 2 * tissue.attenuation * 1e-6 * imaging.transmit_frequency * 1e2 * depths
        rng = np.random.default_rng([seed, 6])
        errors_db = gain_errors(parameters.gain_error_db, geometry.samples, rng)
        clutter = 10 ** (parameters.clutter_db / 20) * np.exp(-depths / parameters.clutter_length)
        self._console = Console(
            box=tissue.surface.bounds,
            gel_thickness=float(parameters.gel_thickness),
            noise=(10 ** ((parameters.noise_db + loss_db) / 20)).astype(np.float32),
            grey_per_db=float(imaging.grey_per_db),
            offsets=(imaging.tissue_grey + imaging.grey_per_db * errors_db).astype(np.float32),
            clutter=np.repeat(clutter.astype(np.float32), 2),
            lasting=float(np.sqrt(1 - parameters.decorrelation)),
        )
        self._changing = np.sqrt(parameters.decorrelation) * 10 ** (tissue.level_db / 20)
        self._field = np.zeros((self.geometry.frames, 0, 0), np.complex64)
        if parameters.clutter_db > -200 or parameters.decorrelation > 0:
            self._field = speckle_field(geometry, self.beam, rng)
        rng = np.random.default_rng([seed, 4])
        air = parameters.air_pockets
        self._air = AirPockets(air, transducer, imaging, self.geometry, rng)
        self._keys = lru_cache(maxsize=4)(self._make_keys)
        self._X_FP = motor_poses(geometry)
        self._lines = {direction: line_rays(geometry, direction) for direction in (1, -1)}
        self._rays = {
            d: projection_rays(geometry, self.beam, d, pulses.lead, reference) for d in (1, -1)
        }

    @property
    def varies(self) -> bool:
        """True if the image of a scene at rest changes over time."""
        return self._scene.varies or any(renderer.varies for _, renderer in self._resting)

    @property
    def needle_varies(self) -> bool:
        """True if the echo of a needle at rest changes over time."""
        return self._needle.varies

    def add_tissue(
        self, iq: NDArray[np.complex64], frames: Frames, field: Displacements
    ) -> FrameViews:
        """Write everything except the moving needle to (n, lines, samples) echoes.

        ``field`` holds the displacements of the tissue. Return the views that the needle's echo
        needs.
        """
        X_FT = frame_poses(self._X_FP[frames.part], frames.X_TP)
        rays, scene = self._rays[frames.direction], self._scene
        times = frames.times
        view, gains, nodes_per_metre = scene.view(X_FT, float(rays.twist))
        sights = Sights(X_FT, field, view)
        render_tissue(iq, sights, rays, self._scattering, scene.lumens(times))
        if len(self._inclusions[0]):
            render_points(iq, sights, rays, *self._inclusions, self._point_pulse)
        transmission = np.empty((0, 0, 0), np.float32)
        if scene.pieces is not None:
            transmission = np.ones(iq.shape, np.float32)
            weakened = gains is not None
            if gains is not None:
                expand_gains(transmission, gains, nodes_per_metre * self.acoustic.sample_pitch)
            growth = scene.growth(times)
            render_surfaces(iq, transmission, sights, rays, scene.pieces, growth, weakened)
        views = FrameViews(sights, rays, transmission, times)
        for needle, renderer in self._resting:
            renderer.add_resting(iq, needle, views)
        return views

    def add_needle(self, iq: NDArray[np.complex64], frames: Frames, views: FrameViews) -> None:
        """Add the moving needle with its shadow, and its track, to the tissue's echoes."""
        views = views._replace(times=frames.times)
        needles = frames.needles
        if any(needle.track is not None for needle in needles):
            none = np.zeros((0, 3))
            shafts = [none if needle.track is None else needle.track for needle in needles]
            tracks = [Needle(shaft, needles[0].radius) for shaft in shafts]
            self._track.add(iq, tracks, views)
        if any(needles):
            self._needle.add(iq, needles, views)

    def add_points(
        self,
        iq: NDArray[np.complex64],
        frames: Frames,
        points: NDArray[np.float64],
        amplitudes: NDArray[np.complex128],
    ) -> None:
        """Add the echoes of point scatterers, in place; see `SweepRenderer.add_scatterers`."""
        rays = self._rays[frames.direction]
        X_FT = frame_poses(self._X_FP[frames.part], frames.X_TP)
        view, *_ = self._scene.view(X_FT, float(rays.twist))
        sights = Sights(X_FT, displacements(None), view)
        render_points(iq, sights, rays, points, amplitudes, self._point_pulse)

    def grey_levels(
        self, iq: NDArray[np.complex64], frames: Frames, number: int
    ) -> NDArray[np.uint8]:
        """Return the grey levels of frames' echoes; the number of the sweep selects the noise."""
        grey = np.empty(iq.shape, np.uint8)
        origins, directions = self._lines[frames.direction]
        turned = np.exp(1j * frames.times / self._parameters.decorrelation_time)
        acquired = Acquired(
            np.ascontiguousarray(frames.X_TP[:, :3]),
            origins[frames.part],
            directions[frames.part],
            self._air.open_shares(frames.times, frames.part),
            self._keys(number)[frames.part],
            self._field[frames.part],
            self._changing * turned,
        )
        form_image(grey, iq, self._console, acquired)
        return grey

    def _make_keys(self, number: int) -> NDArray[Any]:
        """Return the (frames,) keys of the noise in a sweep."""
        keys = np.random.SeedSequence([self._seed, number])
        return keys.generate_state(self.geometry.frames, np.uint64)
