"""Leaf system that converts the only frame of a sweep to a slice, and the conversion."""

from functools import lru_cache

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem
from scipy.ndimage import map_coordinates

from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound, seal
from sonoservo.systems.signals.ports import declare_inputs, declare_output, evaluate
from sonoservo.systems.signals.requirements import require, require_positive
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry


class SliceConversion:
    """Scan conversion of sweeps of a single frame; the motor's turn within it is neglected.

    Raises ValueError if a sweep has more frames, or the slice fewer than 3 pixels along an axis.
    """

    def __init__(self, geometry: SweepGeometry, spacing: float) -> None:
        require(geometry.frames == 1, "frames", geometry.frames, "1, to make slices")
        require_positive(spacing=spacing)
        lines, samples = geometry.shape[1:]
        j, i = np.meshgrid(np.linspace(0, lines - 1, 41), [0, samples - 1], indexing="ij")
        corners = geometry.position(0, j, i, 1)[..., :2].reshape(-1, 2)
        low, high = corners.min(axis=0), corners.max(axis=0)
        shape = np.floor((high - low) / spacing + 1e-9).astype(int) + 1
        most = float((high - low).min()) / 2
        require(
            min(shape) >= 3, "pixel", spacing, f"at most {most:.4g} m, so that 3 fit in a slice"
        )
        # Centred across the beam, and aligned with the shallowest sample in depth.
        self._origin = np.array([-0.5 * spacing * (shape[0] - 1), low[1]])
        self._spacing = np.full(2, spacing)
        x, y = np.meshgrid(
            *(self._origin[axis] + spacing * np.arange(shape[axis]) for axis in range(2)),
            indexing="ij",
        )
        _, line, sample = geometry.index(np.stack([x, y, np.zeros_like(x)], axis=-1), 1)
        self._apex = -geometry.array_radius
        self._index = np.stack([line, sample]).astype(np.float32)

    def __call__(self, sweep: Sweep) -> ImageSlice:
        """Convert the sweep's only frame."""
        picture = map_coordinates(sweep.samples[0], self._index, order=1, prefilter=False)
        X_WP = RigidTransform(sweep.motion.X_WP[0])
        return ImageSlice(
            seal(picture),
            self._origin,
            self._spacing,
            X_WP,
            sweep.motion.time,
            self._apex,
            sweep.decibels_per_level,
        )


class SliceConverter(LeafSystem):
    """Converts each sweep of a single frame to a slice; stateless, with a cached result.

    .. pydrake_system::

        name: SliceConverter
        input_ports:
        - sweep
        output_ports:
        - slice

    ``sweep`` holds a `Sweep`, or a `NotFound` that is passed on; ``slice`` holds an `ImageSlice`.

    Parameters
    ----------
    geometry
        Geometry of the sweeps.
    spacing
        Distance between the slice's pixels, in m.
    """

    def __init__(self, *, geometry: SweepGeometry, spacing: float) -> None:
        super().__init__()
        self.set_name("slice_converter")
        # The framework marks all state as changed at every event, but a sweep is immutable.
        self._conversion = lru_cache(maxsize=1)(SliceConversion(geometry, spacing))
        declare_inputs(self, sweep=(Sweep, NotFound))
        sweep = self.GetInputPort("sweep")
        declare_output(self, "slice", (ImageSlice, NotFound), self._calc_slice, {sweep.ticket()})

    def _calc_slice(self, context: Context, output: Value) -> None:
        sweep = evaluate(self, context, "sweep", (Sweep, NotFound))
        output.set_value(sweep if isinstance(sweep, NotFound) else self._conversion(sweep))
