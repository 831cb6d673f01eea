"""Localization of a needle's cross-section in one slice (Carriere 2016, section II)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from sonoservo.systems.shape.normalized_cross_correlation import Match, best_match
from sonoservo.systems.signals.cross_section import CrossSection
from sonoservo.systems.signals.image_slice import ImageSlice
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.needle_shape import NeedleShape
from sonoservo.systems.signals.requirements import (
    NotNegative,
    Positive,
    check_bounds,
    require,
    within,
)

Floats = NDArray[np.float64]


def echo_vertex(
    image: ImageSlice, near: Floats, fitted: Sequence[float], reach: Sequence[float]
) -> Floats | NotFound:
    """Return the (2,) vertex in P, in m, of the brightest echo within ``reach`` of ``near``.

    The echo of a thin needle is the beam's point spread function, which is nearly a Gaussian. Its
    logarithm is a paraboloid, fitted by least squares to the pixels within ``fitted`` of the
    brightest. Both are half widths and half heights in m.
    """
    half = np.maximum(np.rint(fitted / image.spacing).astype(int), 1)
    pixels = np.maximum(np.rint(reach / image.spacing).astype(int), 1)
    first = np.rint(image.index(near)).astype(int) - pixels - half
    last = first + 2 * (pixels + half) + 1
    if np.any(first < 0) or np.any(last > image.intensities.shape):
        return NotFound("the needle is at the edge of the image")
    around = image.intensities[first[0] : last[0], first[1] : last[1]].astype(np.float64)
    windows = np.lib.stride_tricks.sliding_window_view(around, tuple(2 * half + 1))
    # Across the beam the echo is as wide as the window. Along the beam it is as thin as a pixel.
    level = windows[..., half[1]].mean(axis=2)
    window = np.array(np.unravel_index(np.argmax(level), level.shape))
    offset = _paraboloid_vertex(windows[tuple(window)])
    return image.position(first + window + half + np.clip(offset, -half, half))


def _paraboloid_vertex(values: Floats) -> Floats:
    """Return the (2,) offset of the vertex from the middle of an odd-sized array, in elements."""
    _, a, b, c, d, e = _paraboloid_fit(values.shape) @ values.ravel()
    determinant = 4 * c * e - d * d
    if c >= 0 or determinant <= 0:
        return np.zeros(2)
    return np.array([d * b - 2 * e * a, d * a - 2 * c * b]) / determinant


@lru_cache
def _paraboloid_fit(shape: tuple[int, int]) -> Floats:
    """Return the (6, n) matrix that fits the coefficients of 1, i, j, i^2, ij, j^2."""
    rows, columns = ((extent - 1) // 2 for extent in shape)
    i, j = np.meshgrid(
        np.arange(-rows, rows + 1.0), np.arange(-columns, columns + 1.0), indexing="ij"
    )
    design = np.stack([np.ones_like(i), i, j, i * i, i * j, j * j], axis=-1).reshape(-1, 6)
    return np.linalg.pinv(design)


DEVIATIONS = ("both", "signed", "brighter")
"""Choices of the deviations from the mean that a variance image shows."""

POSITIONS = ("front", "match")
"""Choices of the position of a cross-section."""


@dataclass(kw_only=True)
class CrossSectionParameters:
    """Settings of the search for a cross-section.

    Parameters
    ----------
    start
        x and y in P of the needle in the first slice, in m, as a person would point at it. None
        finds the needle automatically.
    start_reach
        Reach of the search for the echo around the point of ``start``, along X and Y, in m.
    start_slices
        Number of slices that are examined before the start. A needle appears in all of them, a
        fibre does not.
    follow_shape_from
        Observed depth in m from which the region of interest is centred on the predicted shape.
        Before that it is centred on the last cross-section.
    expected_std
        Standard deviation along X and Y of a cross-section about its expected place, in m, in
        addition to that of the predicted shape: the tissue shifts with the breath, and a needle
        turns by some degrees. Another needle nearby matches as well, but lies too far from that
        place. Not used if ``position`` is "match".
    template
        Width w and height h of the template in m; the region of interest is 2w x 2h.
    deviations
        Deviations from the mean that the variance image (eq. 1) shows. "both" shows them alike, as
        printed. Shadows and the dark grains of speckle are then as bright as echoes. "signed" keeps
        their sign, and "brighter" shows only those above the mean.
    position
        Position of the cross-section. "match" takes the best match with the template, as printed,
        and the person's point in the first slice. The errors of the successive templates then add
        up to a drift. "front" takes the axis behind the front of the echo near that place.
    min_correlation
        Correlation with the last template below which the needle counts as lost.
    min_contrast_db
        Smallest level of the needle's echo above the mean of the image, in dB; with "match" it is
        not examined.
    vertex
        Half width and half height in m of the part of the echo to which a paraboloid is fitted.
    search
        Reach of the search for the brightest echo, that of the front wall, around the place given
        by the template, across and along the beam, in m. Along the beam the reach is longer than
        the distance between reverberations, and a start on the wrong one is soon corrected.
    needle_radius
        Radius of the needle in m. The front wall's echo is closer to the probe than the axis by
        this distance.
    """

    start: list[float] | None = None
    start_reach: Positive = 1.6e-3
    start_slices: Annotated[int, within(1, 20)] = 4
    follow_shape_from: NotNegative = 10e-3
    expected_std: Positive = 0.5e-3
    template: list[float] = field(default_factory=lambda: [6e-3, 6e-3])
    deviations: str = "brighter"
    position: str = "front"
    min_correlation: float = 0.4
    min_contrast_db: float = 12.0
    vertex: list[float] = field(default_factory=lambda: [0.6e-3, 0.2e-3])
    search: list[float] = field(default_factory=lambda: [0.8e-3, 1.1e-3])
    needle_radius: Positive = 0.635e-3

    def __post_init__(self) -> None:
        if self.start is not None:
            require(len(self.start) == 2, "start", self.start, "two coordinates in m")
        check_bounds(self)
        for name in ("template", "vertex", "search"):
            value = getattr(self, name)
            require(len(value) == 2 and min(value) > 0, name, value, "two lengths in m above 0")
        for name, choices in (("deviations", DEVIATIONS), ("position", POSITIONS)):
            value = getattr(self, name)
            require(value in choices, name, value, f"one of {', '.join(choices)}")
        require(
            0 <= self.min_correlation < 1,
            "min_correlation",
            self.min_correlation,
            "at least 0 and below 1",
        )


def variance_image(
    intensities: NDArray[np.uint8], mean: float, *, deviations: str = "both"
) -> NDArray[np.float32]:
    """Return the squared deviation from the whole image's ``mean`` (eq. 1); see `DEVIATIONS`."""
    # The paper divides by the largest value, which changes no correlation coefficient.
    deviation = intensities.astype(np.float32) - np.float32(mean)
    if deviations == "signed":
        return deviation * np.abs(deviation)
    if deviations == "brighter":
        np.maximum(deviation, 0, out=deviation)
    return deviation * deviation


def image_mean(image: ImageSlice) -> float:
    """Return the mean intensity within the sector, without the zeros outside it."""
    total, count = image.intensities.sum(dtype=np.int64), np.count_nonzero(image.intensities)
    return float(total / max(count, 1))


def find_needle(image: ImageSlice, parameters: CrossSectionParameters) -> Floats | NotFound:
    """Return (2,) x and y in P, in m, of the axis below the brightest echo of an image."""
    sigma = [0.5 * length for length in parameters.vertex] / image.spacing
    blurred = gaussian_filter(image.intensities, sigma, output=np.float32)
    peak = np.unravel_index(np.argmax(blurred), blurred.shape)
    head = image.position(peak)
    return _axis_of(
        echo_vertex(image, head, parameters.vertex, parameters.search), image, parameters
    )


def start_at(
    image: ImageSlice, centre: Floats, parameters: CrossSectionParameters
) -> CrossSection | NotFound:
    """Find the first cross-section, near (2,) x and y in P, in m."""
    return _at(image, np.asarray(centre, dtype=float), 1.0, image_mean(image), parameters)


def find_first(
    images: Sequence[ImageSlice], parameters: CrossSectionParameters
) -> CrossSection | NotFound:
    """Find the first cross-section in the newest of the slices since the last attempt began."""
    image = images[-1]
    if parameters.start is not None:
        reach = [max(each, parameters.start_reach) for each in parameters.search]
        return start_at(image, np.array(parameters.start), replace(parameters, search=reach))
    if len(images) < parameters.start_slices:
        return NotFound("the first slices are still being compared")
    lasting = np.min([each.intensities for each in images], axis=0)
    centre = find_needle(replace(image, intensities=lasting), parameters)
    return centre if isinstance(centre, NotFound) else start_at(image, centre, parameters)


def expected_position(
    image: ImageSlice,
    last: CrossSection,
    shape: NeedleShape | NotFound,
    parameters: CrossSectionParameters,
) -> tuple[Floats, float]:
    """Return the expected (2,) x and y in P of the needle in the next slice and their std, in m."""
    p_W, std = last.position, 0.0
    if isinstance(shape, NeedleShape) and shape.observed >= parameters.follow_shape_from:
        depth = shape.X_WI.inverse().multiply(image.X_WP.translation())[2]
        p_W, std = shape.positions([depth])[0], float(shape.std([depth])[0])
    return image.X_WP.inverse().multiply(p_W)[:2], float(np.hypot(std, parameters.expected_std))


def find_again(
    image: ImageSlice,
    last: CrossSection,
    expected: tuple[Floats, float],
    parameters: CrossSectionParameters,
) -> CrossSection | NotFound:
    """Find a cross-section in the next slice, around the `expected_position`."""
    size = np.array(last.template.shape)
    around = image.index(expected[0])
    first = np.rint(around).astype(int) - size
    shape = np.array(image.intensities.shape)
    low, high = np.maximum(first, 0), np.minimum(first + 2 * size + 1, shape)
    if np.any(high - low < size):
        return NotFound("the needle has left the image")
    mean = image_mean(image)
    region = image.intensities[low[0] : high[0], low[1] : high[1]]
    prior = None
    if parameters.position == "front":
        # Only the cells of speckle and echoes that hold the template's energy tell a place.
        energy = (last.template - last.template.mean(dtype=float)) ** 2
        pixels = energy.sum() ** 2 / max(float((energy**2).sum()), 1e-300)
        cells = max(pixels * np.prod(image.spacing / parameters.vertex) / 2, 1.0)
        places = (
            np.indices(tuple(region.shape - size + 1)) + (low + 0.5 * (size - 1))[:, None, None]
        )
        away = (places - around[:, None, None]) * image.spacing[:, None, None]
        prior = -0.5 * (away**2).sum(axis=0) / expected[1] ** 2 / cells
    match = best_match(
        variance_image(region, mean, deviations=parameters.deviations),
        last.template,
        prior,
        parameters.min_correlation,
    )
    if not isinstance(match, Match):
        return match
    if match.correlation < parameters.min_correlation:
        return NotFound(
            f"the correlation {match.correlation:.2f} with the template is below "
            f"{parameters.min_correlation:g}"
        )
    place = low + match.position + 0.5 * (size - 1)
    if parameters.position == "match":
        # The last template was cut at whole pixels.
        cut = image.index(last.centre) - 0.5 * (size - 1)
        place += cut - np.rint(cut)
    centre = image.position(place)
    return _at(image, centre, match.correlation, mean, parameters)


def _at(
    image: ImageSlice,
    centre: Floats,
    correlation: float,
    mean: float,
    parameters: CrossSectionParameters,
) -> CrossSection | NotFound:
    """Refine a cross-section, if requested, and cut its template."""
    axis = centre
    if parameters.position == "front":
        refined = _refined(image, centre, mean, parameters)
        if isinstance(refined, NotFound):
            return refined
        axis = refined
    size = np.rint(parameters.template / image.spacing).astype(int)
    first = np.rint(image.index(axis) - 0.5 * (size - 1)).astype(int)
    if np.any(first < 0) or np.any(first + size > image.intensities.shape):
        return NotFound("the needle is at the edge of the image")
    patch = image.intensities[first[0] : first[0] + size[0], first[1] : first[1] + size[1]]
    return CrossSection(
        position=image.to_world(axis),
        X_WP=image.X_WP.GetAsMatrix4(),
        time=image.time,
        correlation=correlation,
        centre=axis,
        template=variance_image(patch, mean, deviations=parameters.deviations),
    )


def _refined(
    image: ImageSlice, centre: Floats, mean: float, parameters: CrossSectionParameters
) -> Floats | NotFound:
    """Return the position of the axis behind the front of the echo near a point."""
    front = _front_of(centre, image, parameters)
    head = echo_vertex(image, front, parameters.vertex, parameters.search)
    if isinstance(head, NotFound):
        return head
    at = tuple(np.rint(image.index(head)).astype(int))
    contrast = image.decibels_per_level * (float(image.intensities[at]) - mean)
    if contrast < parameters.min_contrast_db:
        return NotFound(
            f"the echo is only {contrast:.0f} dB above the tissue; "
            f"{parameters.min_contrast_db:g} dB are required"
        )
    return _axis_of(head, image, parameters)


def _front_of(axis: Floats, image: ImageSlice, parameters: CrossSectionParameters) -> Floats:
    """Return the position of the front wall's echo for a needle with this axis."""
    return axis - parameters.needle_radius * image.beam_direction(axis)


def _axis_of(
    head: Floats | NotFound, image: ImageSlice, parameters: CrossSectionParameters
) -> Floats | NotFound:
    """Return the position of the axis of a needle whose front wall's echo is at ``head``."""
    if isinstance(head, NotFound):
        return head
    return head + parameters.needle_radius * image.beam_direction(head)
