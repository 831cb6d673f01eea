"""Renderer of a needle's echo in every frame: shaft, tip, reverberation and shadow."""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.kernels.medium import (
    Sights,
    apparent_shaft,
)
from sonoservo.systems.ultrasound.simulation.kernels.projection import Rays
from sonoservo.systems.ultrasound.simulation.needles.needle_echo import (
    NeedleEchoParameters,
    NeedleFading,
    needle_echo,
    needle_view,
    reverberations,
    rough_phases,
)
from sonoservo.systems.ultrasound.simulation.needles.needle_kernel import (
    NeedleEcho,
    render_needles,
    together,
)
from sonoservo.systems.ultrasound.simulation.pulses import PulseTables
from sonoservo.systems.ultrasound.simulation.reaction.deformation import moved_needle

_BENT_STEP = 1e-3


class FrameViews(NamedTuple):
    """Geometry and propagation of a sweep's frames, as needed to render a needle."""

    sights: Sights
    rays: Rays
    transmission: NDArray[np.float32]
    """(frames, lines, samples) factors on echoes from behind structures; empty if none."""
    times: NDArray[np.float64]
    """(frames,) times of the frames, in s."""


class NeedleRenderer:
    """Adds the echoes of one kind of needle to those of the tissue.

    Geometry is that of the sweeps with lengths in the tissue; levels hold at the sample
    ``reference``.
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
        self._reference = reference
        self._echo = lru_cache(maxsize=8)(self._make_echo)

    @property
    def varies(self) -> bool:
        """True if the echo changes with time."""
        return self._parameters.fading_db > 0

    def add(self, iq: NDArray[np.complex64], needles: Sequence[Needle], views: FrameViews) -> None:
        """Add a needle's echoes to (frames, lines, samples) echoes, with its shadow.

        Needles are in T at each frame's time, possibly empty, and have the same radius.
        """
        parameters, (X_FT, _, bent) = self._parameters, views.sights
        offset = self._geometry.array_radius - self._geometry.motor_radius
        view = needle_view(parameters, self._fading, self._beam, needles, X_FT, offset, views.times)
        shafts = [needle.shaft for needle in needles]
        if len(bent.table):
            shafts = [
                apparent_shaft(shaft, X_FT[frame], bent, frame, _BENT_STEP) if len(shaft) else shaft
                for frame, shaft in enumerate(shafts)
            ]
        echo = self._echo(needles[0].radius)
        render_needles(iq, X_FT, views.rays, *together(shafts), echo, view, views.transmission)

    def add_resting(self, iq: NDArray[np.complex64], needle: Needle, views: FrameViews) -> None:
        """Add a needle at rest in T, which moves with the tissue if a field deforms it."""
        field = views.sights.fields
        frames = range(len(iq))
        deformed = len(field.counts) > 0
        moved = [moved_needle(needle, field, f) if deformed else needle for f in frames]
        self.add(iq, moved, views)

    def _make_echo(self, radius: float) -> NeedleEcho:
        """Return the echo of a needle of this radius, with the reverberations inside it."""
        levels, distance = reverberations(self._parameters, radius, self._geometry.sound_speed)
        pulse = self._tables.tabulate(levels, [n * distance for n in range(len(levels))])
        return needle_echo(
            self._parameters, self._beam, self._reference, self._phases, pulse, radius
        )
