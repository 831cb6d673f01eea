"""Renderer of sweeps of a motorised probe over tissue and needle."""

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from threading import Lock
from time import thread_time
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.sampling.workers import workers
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.point_spread import PointSpread
from sonoservo.systems.signals.requirements import require, require_not_negative
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam, point_spread
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation.frame_renderer import FrameRenderer, Frames
from sonoservo.systems.ultrasound.simulation.kernels.image_formation import modulate
from sonoservo.systems.ultrasound.simulation.needles.needle_renderer import FrameViews
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation, displacements
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.simulation.tissue import Tissue
from sonoservo.systems.ultrasound.transducer import Transducer

T = TypeVar("T")

GROUP = 4
"""Number of frames that a thread renders at a time."""

_SWEEPS_AHEAD = 3
"""Number of sweeps that may be begun before one is requested."""


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
    work_s
        Processor time of all images so far, in s, whichever thread made them.
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
        self.parameters, self.seed = parameters, seed
        self.decibels_per_level = imaging.decibels_per_level
        self._renderer = FrameRenderer(transducer, imaging, tissue, parameters, seed)
        self.geometry: SweepGeometry = self._renderer.geometry
        self.beam: Beam = self._renderer.beam
        self.point_spread: PointSpread = point_spread(self.beam, self.geometry)
        self._echoes = {
            (direction, part.start): _Echoes(self._renderer, self._shape(part))
            for direction in (1, -1)
            for part in self.groups(direction)
        }
        self._begun: list[tuple[Frames, int, Future[NDArray[np.uint8]]]] = []
        self._lock, self.work_s = Lock(), 0.0

    def groups(self, direction: int) -> list[slice]:
        """Return the groups in which frames are rendered, in the order of their acquisition."""
        frames = self.geometry.frames
        starts = range(0, frames, GROUP)
        if direction > 0:
            return [slice(start, min(start + GROUP, frames)) for start in starts]
        return [slice(max(frames - start - GROUP, 0), frames - start) for start in starts]

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
        iq = np.empty(self.geometry.shape, np.complex64)

        def render(frames: Frames) -> None:
            field = displacements(frames.deformations)
            self._renderer.add_tissue(iq[frames.part], frames, field)

        self._by_group(render, self._frames(X_TP, [], direction, times, deformations))
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
        iq = np.empty(self.geometry.shape, np.complex64)

        def render(frames: Frames) -> None:
            iq[frames.part] = self._echo(frames)

        self._by_group(render, self._frames(X_TP, needles, direction, times, deformations))
        return iq

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
        return self.on_carrier(self.echo(X_TP, needles, direction, times))

    def on_carrier(self, iq: NDArray[np.complex64]) -> NDArray[np.float32]:
        """Return the radio-frequency lines of echoes; see `radio_frequency_lines`."""
        step = 4 * np.pi / self.beam.wavelength * self._renderer.acoustic.sample_pitch
        phase = step * np.arange(self.geometry.samples)
        lines = np.empty(iq.shape, np.float32)
        carrier = (np.cos(phase).astype(np.float32), np.sin(phase).astype(np.float32))
        _each(lambda part: modulate(lines[part], iq[part], *carrier), self.groups(1))
        return lines

    def add_scatterers(
        self,
        iq: NDArray[np.complex64],
        X_TP: NDArray[np.float64],
        points: NDArray[np.float64],
        amplitudes: NDArray[np.complex128],
        direction: int,
    ) -> None:
        """Add point scatterers to `echo`'s samples, in place.

        (n, 3) points are in T in m, (n,) amplitudes relative to the tissue's at the focus; the
        tissue is not deformed.
        """

        def render(frames: Frames) -> None:
            self._renderer.add_points(iq[frames.part], frames, points, amplitudes)

        self._by_group(render, self._frames(X_TP, [], direction, None, None))

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

        Groups of frames that `begin` was told of are not rendered again.

        Parameters
        ----------
        X_TP, needles, direction, times, deformations
            See `echo`.
        number
            Number of the sweep, which selects the noise.
        """
        grey = np.empty(self.geometry.shape, np.uint8)

        def render(frames: Frames) -> None:
            grey[frames.part] = self._image(frames, number)

        whole = self._frames(X_TP, needles, direction, times, deformations)
        missing = []
        for part in self.groups(direction):
            frames = whole.among(part)
            begun = self._take(frames, number)
            if begun is None:
                missing.append(frames)
            else:
                grey[part] = begun.result()
        self._begun = [each for each in self._begun if each[1] > number]
        _each(render, missing)
        return grey

    @property
    def may_begin(self) -> bool:
        """True if `begin` would do something; frames need not be prepared for it otherwise."""
        most = _SWEEPS_AHEAD * len(self.groups(1))
        return workers() is not None and len(self._begun) < most

    def begin(self, frames: Frames, number: int) -> None:
        """Begin to render one of the `groups` of frames in the background, for a sweep.

        This does nothing without threads to spare (see `workers`), or while the sweeps begun before
        are not requested.
        """
        pool = workers()
        if pool is not None and self.may_begin:
            self._begun.append((frames, number, pool.submit(self._image, frames, number)))

    def _take(self, frames: Frames, number: int) -> Future[NDArray[np.uint8]] | None:
        """Return the image in the making of a group of frames, if it was begun."""
        for begun, sweep, job in self._begun:
            if sweep == number and begun.equals(frames):
                return job
        return None

    def _frames(
        self,
        X_TP: NDArray[np.float64],
        needles: Sequence[Needle],
        direction: int,
        times: NDArray[np.float64] | None,
        deformations: Sequence[Deformation] | None,
    ) -> Frames:
        """Return the frames of a whole sweep."""
        shape = X_TP.shape
        require(shape == (self.geometry.frames, 4, 4), "X_TP", shape, "(frames, 4, 4)")
        times = np.zeros(len(X_TP)) if times is None else times
        return Frames(slice(0, len(X_TP)), direction, X_TP, times, needles, deformations)

    def _by_group(self, render: Callable[[Frames], None], whole: Frames) -> None:
        """Call a function with every group of frames of a sweep."""
        _each(render, [whole.among(part) for part in self.groups(whole.direction)])

    def _image(self, frames: Frames, number: int) -> NDArray[np.uint8]:
        began = thread_time()
        grey = self._renderer.grey_levels(self._echo(frames), frames, number)
        with self._lock:
            self.work_s += thread_time() - began
        return grey

    def _echo(self, frames: Frames) -> NDArray[np.complex64]:
        """Return the echoes of a group of frames."""
        return self._echoes[frames.direction, frames.part.start].echo(frames)

    def _shape(self, part: slice) -> tuple[int, int, int]:
        return (part.stop - part.start, self.geometry.lines, self.geometry.samples)


class _Echoes:
    """Echoes of a group of frames: of the tissue, and with the needle, while nothing changes."""

    def __init__(self, renderer: FrameRenderer, shape: tuple[int, int, int]) -> None:
        self._renderer = renderer
        self._tissue, self._all = np.empty((2, *shape), np.complex64)
        self._key, self._needle_key = b"", b""
        self._views: FrameViews
        self._lock = Lock()

    def echo(self, frames: Frames) -> NDArray[np.complex64]:
        """Return the echoes with those of the needle."""
        renderer = self._renderer
        # Rounded to 10 nm, or 0.0003 rad of phase, so that a probe at rest reuses its echoes.
        frames = replace(frames, X_TP=np.round(frames.X_TP, 8))
        times = frames.times.tobytes()
        with self._lock:
            field = displacements(frames.deformations)
            key = frames.X_TP.tobytes() + (times if renderer.varies else b"")
            key += b"".join(np.asarray(each).tobytes() for each in field)
            if self._key != key:
                self._views = renderer.add_tissue(self._tissue, frames, field)
                self._key, self._needle_key = key, b""
            key = b"at" + (times if renderer.needle_varies else b"")
            key += b"".join(_content(needle) for needle in frames.needles)
            if self._needle_key != key:
                self._all[:] = self._tissue
                renderer.add_needle(self._all, frames, self._views)
                self._needle_key = key
            return self._all.copy()


def _content(needle: Needle) -> bytes:
    """Return what a needle's echo depends on."""
    track = b"" if needle.track is None else needle.track.tobytes()
    numbers = np.array([len(needle.shaft), len(track), needle.radius, needle.roll])
    return numbers.tobytes() + needle.shaft.tobytes() + track


def _each(function: Callable[[T], None], items: Sequence[T]) -> None:
    """Call a function with every item, on as many threads as there are."""
    pool = workers()
    for _ in map(function, items) if pool is None else pool.map(function, items):
        pass
