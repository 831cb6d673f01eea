"""Structures of a tissue, prepared for the kernels."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.beam import Beam
from sonoservo.systems.ultrasound.simulation.kernels.medium import (
    NO_VIEW,
    Medium,
    View,
    integrate_paths,
    tabulate_views,
)
from sonoservo.systems.ultrasound.simulation.kernels.pieces import Pieces
from sonoservo.systems.ultrasound.simulation.kernels.regions import Regions
from sonoservo.systems.ultrasound.simulation.kernels.surface_echo import (
    FAINT_PIECE,
    FURTHEST,
    SHADOW_REACH,
)
from sonoservo.systems.ultrasound.simulation.path_labels import PathLabels, path_labels
from sonoservo.systems.ultrasound.simulation.pulses import PulseTables, stacked
from sonoservo.systems.ultrasound.simulation.scatterers import scatterer_regions
from sonoservo.systems.ultrasound.simulation.structures.structure import Tube
from sonoservo.systems.ultrasound.simulation.structures.surface import Surface, SurfaceEcho
from sonoservo.systems.ultrasound.simulation.tissue import Tissue

_DENSITY = 1.4
_MAX_PIECES = 3_000_000
_NODE = 2e-3
_NO_FAT = -1e9
_VIEW_ANGLE = 0.1
_VIEW_DEPTH = 5e-3
_ASIDE = 0.5e-3


@dataclass(frozen=True)
class _Pulse:
    """Pulsation of a surface: amplitude in m and rate in Hz."""

    amplitude: float = 0.0
    rate: float = 1.0

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        return self.amplitude * np.sin(2 * np.pi * self.rate * times)


class Scene:
    """Structures of a tissue, prepared for one beam.

    Lengths are those in the tissue; levels of surfaces hold at the sample ``reference``.
    ``regions`` and ``pieces``, which may be None, are for the kernels.
    """

    def __init__(
        self,
        tissue: Tissue,
        *,
        beam: Beam,
        geometry: SweepGeometry,
        reference: int,
        pulses: PulseTables,
        block_size: float,
        sound_speed: float,
        frequency: float,
    ) -> None:
        unplaced = [each.kind for each in tissue.structures if each.beside_needle is not None]
        require(not unplaced, "beside_needle", unplaced, "placed by the way of a needle")
        rng = np.random.default_rng([tissue.seed, 2])
        grid = tissue.anatomy.grid() if tissue.anatomy is not None else None
        self._tubes: list[Tube] = [t for each in tissue.structures for t in each.tubes()]
        self.regions: Regions = scatterer_regions(tissue, grid, self._tubes, block_size)
        self._paths: PathLabels | None = path_labels(
            tissue, grid, self._tubes, sound_speed, frequency
        )
        self._geometry = geometry
        self._beam_width = float(beam.lateral[reference])
        self._fat = tissue.fat
        self._fat_ratio = tissue.fat.sound_speed / sound_speed
        spacing = _DENSITY * float(beam.lateral[beam.lateral.size // 8 :].min())
        surfaces: list[tuple[Surface, SurfaceEcho]] = []
        self._growth: list[_Pulse] = []
        for each in tissue.structures:
            own = each.surfaces(spacing, rng)
            tubes = each.tubes()
            beat = (
                _Pulse(tubes[0].radius * tubes[0].pulsation, tubes[0].rate) if tubes else _Pulse()
            )
            surfaces += own
            self._growth += [beat] * len(own)
        if grid is not None:
            surfaces += grid.surfaces
            self._growth += [_Pulse()] * len(grid.surfaces)
        self.pieces: Pieces | None = None
        if surfaces or self._paths is not None:
            tables = [pulses.tabulate([1.0], [0.0])]
            pieces = _pieces(surfaces, beam, reference, rng)
            for number, (_, echo) in enumerate(surfaces):
                if echo.ring_down_db is not None:
                    pieces.pulses[number] = len(tables)
                    length = echo.ring_down_length
                    tables.append(pulses.ring_down(echo.ring_down_db, length, geometry.depth, rng))
            table, widths = stacked(tables)
            self.pieces = pieces._replace(table=table, widths=widths)

    @property
    def varies(self) -> bool:
        """True if any structure pulsates, or blood flows."""
        beats = any(beat.amplitude > 0 for beat in self._growth)
        return beats or any(tube.flow > 0 for tube in self._tubes)

    def lumens(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return (2, frames, tubes) radii in m, and standard deviations of blood's phases in rad.

        The echo of scatterers that have moved by d through a beam with the amplitude exp(-x^2 / 2
        sigma^2) has the correlation exp(-d^2 / 4 sigma^2) with the first one, as if their phases
        had turned by normally distributed angles of d / (sqrt(2) sigma).
        """
        states = [
            (
                tube.radius * (1 + tube.pulsation * np.sin(2 * np.pi * tube.rate * times)),
                tube.flow * times / (np.sqrt(2) * self._beam_width),
            )
            for tube in self._tubes
        ]
        return np.stack(states, axis=-1) if states else np.zeros((2, len(times), 0))

    def growth(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the (frames, surfaces) outward displacements of surfaces at times in s, in m."""
        ways = [beat.at(times) for beat in self._growth]
        return np.stack(ways, axis=-1) if ways else np.zeros((len(times), 0))

    def view(
        self, X_FT: NDArray[np.float64], twist: float
    ) -> tuple[View, NDArray[np.float32] | None, float]:
        """Return the effects of propagation on every frame's echoes.

        For (frames, 3, 4) poses of the tissue in F and the motor's turn in rad per line, they are
        apparent positions by refraction and delay, (frames, lines, nodes) gains or None, and nodes
        per metre.
        """
        if self._fat.thickness == 0 and self._paths is None:
            return NO_VIEW, None, 1 / _NODE
        geometry = self._geometry
        frames = len(X_FT)
        normals = np.zeros((frames, 3))
        offsets = np.full(frames, _NO_FAT)
        if self._fat.thickness > 0 and self._fat_ratio != 1:
            normals = np.ascontiguousarray(-X_FT[:, :, 2])
            lower = X_FT[:, :, 3] - self._fat.thickness * X_FT[:, :, 2]
            offsets = np.einsum("fi,fi->f", normals, lower)
        medium = Medium(
            normals=normals,
            offsets=offsets,
            ratio=self._fat_ratio,
            array_radius=geometry.array_radius,
            centre_offset=geometry.array_radius - geometry.motor_radius,
            delays=np.zeros((frames, 0, 0), np.float32),
            lines_per_radian=1 / geometry.line_pitch,
            nodes_per_metre=1 / _NODE,
        )
        if self._paths is None:
            return self._tabulated(medium), None, 1 / _NODE
        nodes = max(int(np.ceil(geometry.depth / _NODE)) + 1, 2)
        gains = np.empty((frames, geometry.lines, nodes), np.float32)
        delays = np.empty_like(gains)
        R = np.swapaxes(X_FT[:, :, :3], 1, 2)
        X_TF = np.ascontiguousarray(np.concatenate([R, -R @ X_FT[:, :, 3:]], axis=2))
        paths = self._paths
        integrate_paths(gains, delays, X_TF, medium, paths, geometry.line_pitch, twist)
        if paths.delay_rate.any():
            medium = medium._replace(delays=delays)
        return self._tabulated(medium), gains, 1 / _NODE

    def _tabulated(self, medium: Medium) -> View:
        """Return the apparent positions of points."""
        if not medium.delays.size and not (medium.offsets > _NO_FAT).any():
            return NO_VIEW
        geometry = self._geometry
        half = 1.1 * geometry.line_pitch * geometry.lines / 2 + 0.05
        angles = 2 * int(np.ceil(half / _VIEW_ANGLE)) + 1
        nearest = max(geometry.array_radius - 2e-3, 1e-3)
        depths = int(np.ceil((geometry.depth + 0.008) / _VIEW_DEPTH)) + 1
        view = View(
            table=np.empty((len(medium.offsets), angles, depths, 15)),
            angles_per_radian=1 / _VIEW_ANGLE,
            middle=float(angles // 2),
            nearest=nearest,
            depths_per_metre=1 / _VIEW_DEPTH,
            centre_offset=medium.centre_offset,
            asides=np.zeros(len(medium.offsets)),
            furthest=0.0,
        )
        tabulate_views(view.table, medium, view)
        # Beyond the outermost lines by a node, nothing comes back into the image.
        inner = int(np.ceil(geometry.line_pitch * geometry.lines / 2 / _VIEW_ANGLE)) + 1
        outside = max(angles // 2 - inner, 0)
        moved = view.table[:, outside : angles - outside, :, :3]
        asides = np.abs(moved[..., 2]).max(axis=(1, 2)) + _ASIDE
        furthest = float(np.sqrt((moved**2).sum(axis=-1).max())) + _ASIDE
        return view._replace(asides=asides, furthest=furthest)


def _pieces(
    surfaces: list[tuple[Surface, SurfaceEcho]],
    beam: Beam,
    reference: int,
    rng: np.random.Generator,
) -> Pieces:
    """Return the surfaces' pieces, whose amplitudes under the beam add up in phase to the level."""
    counts = [len(surface.areas) for surface, _ in surfaces]
    require(sum(counts) <= _MAX_PIECES, "structures", sum(counts), "smaller: 3,000,000 pieces")
    none = [Surface(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))]
    parts = [surface for surface, _ in surfaces] + none
    areas = np.concatenate([part.areas for part in parts])

    def spread(values: list[float]) -> NDArray[np.float64]:
        return np.repeat(np.array(values, dtype=float), counts)

    section = 2 * np.pi * beam.lateral[reference] * beam.elevation[reference]
    levels = spread([10 ** (e.level_db / 20) if e.specular else 0.0 for _, e in surfaces])
    rough = spread([10 ** ((e.level_db + e.diffuse_db) / 20) for _, e in surfaces])
    phases = np.exp(2j * np.pi * rng.random(len(areas)))
    largest = spread([part.areas.max(initial=0.0) for part in parts[:-1]])
    specular = levels * areas / section
    diffuse = rough * np.sqrt(2 * areas / section) * phases
    shadows = spread([e.shadow for _, e in surfaces])
    cell = beam.resolution_cell
    loudest = (specular + np.abs(diffuse)) * np.sqrt(cell[reference] / cell.min())
    reach = np.maximum(np.log(loudest / FAINT_PIECE + 1e-9), SHADOW_REACH * (shadows > 0))
    return Pieces(
        points=np.concatenate([part.points for part in parts]),
        normals=np.concatenate([part.normals for part in parts]),
        surfaces=np.repeat(np.arange(len(surfaces)), counts),
        specular=specular,
        diffuse=diffuse,
        blocked=shadows * areas,
        steps=np.sqrt(largest),
        one_sided=np.array([e.one_sided for _, e in surfaces], dtype=np.bool_),
        reverberation=np.array(
            [
                0.0 if e.reverberation_db is None else 10 ** (e.reverberation_db / 20)
                for _, e in surfaces
            ]
        ),
        pulses=np.zeros(len(surfaces), np.int64),
        table=np.zeros((0, 0), np.float32),
        widths=np.zeros(0, np.int64),
        reaches=np.sqrt(np.clip(reach / FURTHEST, 0, 1)),
    )
