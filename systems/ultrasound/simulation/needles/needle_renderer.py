"""Renderer of a needle's echo in every frame: shaft, tip, reverberation and shadow."""

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.kernels.displacement import Displacements
from sonoservo.systems.ultrasound.simulation.kernels.medium import View, apparent_points
from sonoservo.systems.ultrasound.simulation.kernels.projection import DepthTables, Rays
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import (
    NeedleEchoParameters,
    NeedleFading,
    needle_echo,
    needle_view,
    reverberations,
    rough_phases,
)
from sonoservo.systems.ultrasound.simulation.needles.needle_kernel import render_needles
from sonoservo.systems.ultrasound.simulation.pulses import PulseTables
from sonoservo.systems.ultrasound.simulation.reaction.deformation import moved_needle

_BENT_STEP = 1e-3


class FrameViews(NamedTuple):
    """Geometry and propagation of a sweep's frames, as needed to render a needle."""

    X_FT: NDArray[np.float64]
    """(frames, 3, 4) poses of the tissue in each frame's F."""
    rays: Rays
    tables: DepthTables
    bent: View
    """Apparent positions of points."""
    transmission: NDArray[np.float32]
    """(frames, lines, samples) factors on echoes from behind structures; empty if none."""
    times: NDArray[np.float64]
    """(frames,) times of the frames, in s."""


class NeedleRenderer:
    """Adds the echoes of one kind of needle to those of the tissue.

    Parameters
    ----------
    parameters
        Parameters of the needle's echo.
    beam, geometry
        Point spread function, and geometry of the sweeps with lengths in the tissue.
    reference
        Sample at which the levels hold.
    pulses
        Pulses of the beam.
    seeds
        Random seeds of the needle's surface.
    """

    def __init__(
        self,
        parameters: NeedleEchoParameters,
        beam: Beam,
        geometry: SweepGeometry,
        reference: int,
        pulses: PulseTables,
        seeds: Sequence[int],
    ) -> None:
        self._parameters = parameters
        self._beam = beam
        self._geometry = geometry
        self._tables = pulses
        rng = np.random.default_rng(list(seeds))
        self._phases = rough_phases(beam, rng)
        self._fading = NeedleFading(parameters, rng)
        self._echoes = lru_cache(maxsize=8)(partial(needle_echo, parameters, beam, reference))
        self._pulses = lru_cache(maxsize=8)(self._pulse)

    @property
    def varies(self) -> bool:
        """True if the echo changes with time."""
        return self._parameters.fading_db > 0

    def add(self, iq: NDArray[np.complex64], needles: Sequence[Needle], views: FrameViews) -> None:
        """Add a needle's echoes to (frames, lines, samples) echoes, with its shadow.

        Parameters
        ----------
        iq
            Echoes, changed.
        needles
            Needle in T at each frame's time, possibly empty; all have the same radius.
        views
            Geometry and propagation of the frames.
        """
        parameters, X_FT = self._parameters, views.X_FT
        offset = self._geometry.array_radius - self._geometry.motor_radius
        view = needle_view(parameters, self._fading, self._beam, needles, X_FT, offset, views.times)
        shafts = [needle.shaft for needle in needles]
        if len(views.bent.table):
            shafts = [
                _apparent(needle, X, views.bent, frame)
                for frame, (needle, X) in enumerate(zip(needles, X_FT, strict=True))
            ]
        radius = needles[0].radius
        render_needles(
            iq,
            X_FT,
            np.concatenate(shafts),
            np.concatenate([[0], np.cumsum([len(shaft) for shaft in shafts])]),
            radius,
            *self._echoes(radius),
            self._phases,
            views.rays,
            views.tables,
            self._pulses(radius),
            view,
            views.transmission,
        )

    def add_resting(
        self,
        iq: NDArray[np.complex64],
        needle: Needle,
        field: Displacements,
        views: FrameViews,
    ) -> None:
        """Add a needle at rest in T, which moves with the tissue if a field deforms it."""
        frames = range(len(iq))
        deformed = len(field.counts) > 0
        moved = [moved_needle(needle, field, f) if deformed else needle for f in frames]
        self.add(iq, moved, views)

    def _pulse(self, radius: float) -> NDArray[np.float32]:
        """Return the pulse with the reverberations inside a needle of this radius."""
        levels, distance = reverberations(self._parameters, radius, self._geometry.sound_speed)
        return self._tables.tabulate(levels, [n * distance for n in range(len(levels))])


def _apparent(
    needle: Needle, X_FT: NDArray[np.float64], view: View, frame: int
) -> NDArray[np.float64]:
    """Return the (m, 3) apparent positions in T, in m, of points along a needle in a frame."""
    if not needle:
        return needle.shaft
    count = max(int(np.ceil(needle.length / _BENT_STEP)), 1) + 1
    points = needle.position(np.linspace(0, needle.length, count))
    R, p = X_FT[:, :3], X_FT[:, 3]
    seen = apparent_points(points @ R.T + p, view, frame)
    return (seen - p) @ R
