"""Width of a scanner's beam at every depth."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from sonoservo.systems.signals.immutable import Immutable
from sonoservo.systems.signals.point_spread import FWHM_PER_SIGMA, PointSpread
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.transducer import Transducer

_DEPTHS = 48
_OFFSETS = 64
_FREQUENCIES = 5

_MOST_BEAMS = 16
"""Number of beams that are kept."""


@dataclass(frozen=True, eq=False)
class Beam(Immutable):
    """The pulse-echo point spread function as a Gaussian whose widths depend on depth."""

    # A point at lateral offset l, elevation offset e and depth d from a line's axis echoes with
    #
    #     exp(-l^2 / (2 sigma_l^2) - e^2 / (2 sigma_e^2)) exp(-2i (2 pi / wavelength) p),
    #     p = d + curvature e^2 / 2
    #
    # at the path p, and the echo's envelope along the line is exp(-(path - p)^2 / (2 sigma_a^2)).
    # Each sigma is chosen for the true full width at half amplitude (-6 dB), which follows from the
    # aperture integrals.

    wavelength: float
    axial: float
    """Standard deviation sigma_a in m."""
    lateral: NDArray[np.float64]
    """(samples,) standard deviations sigma_l in m at every sample's depth."""
    elevation: NDArray[np.float64]
    """(samples,) standard deviations sigma_e in m."""
    curvature: NDArray[np.float64]
    """(samples,) curvature of the wave fronts in elevation, in 1/m."""
    side_lobes: float
    """Amplitude of a rod's echo through the side lobes, relative to that through the Gaussian."""

    @property
    def resolution_cell(self) -> NDArray[np.float64]:
        """Integral of the squared Gaussian over space, (samples,), in m^3."""
        return np.pi**1.5 * self.axial * self.lateral * self.elevation


def transmitted_spectrum(
    frequency: NDArray[np.float64], centre: float, fractional_bandwidth: float
) -> NDArray[np.float64]:
    """Return the two-way spectrum of one sine cycle through a transducer, not normalised.

    The transducer's response falls to a half at the edges of its band and to 1/126 at zero
    frequency (a generalised normal window, as in Garcia 2022, "SIMUS", section 2.4).
    """
    offset = (frequency - centre) / centre
    power = np.log(126) / np.log(2 / fractional_bandwidth)
    response = 0.5 ** (np.abs(2 * offset / fractional_bandwidth) ** power)
    return np.abs(np.sinc(offset) - np.sinc(offset + 2)) * response


def axial_width(centre: float, fractional_bandwidth: float, sound_speed: float) -> float:
    """Return the full width at half maximum of an echo's envelope along a line, in m."""
    frequency = centre * np.linspace(0, 2, 801)[1:]
    spectrum = transmitted_spectrum(frequency, centre, fractional_bandwidth)
    distance = np.linspace(0, 4, 801) * sound_speed / centre
    phase = 2 * np.pi * 2 * distance[:, np.newaxis] * (frequency - centre) / sound_speed
    envelope = np.abs(_sum(np.exp(1j * phase), spectrum))
    return 2 * float(np.interp(0.5, (envelope / envelope[0])[::-1], distance[::-1]))


def _half_width(offsets: NDArray[np.float64], amplitude: NDArray[np.float64]) -> float:
    """Return the last offset at which the amplitude crosses half its maximum."""
    relative = amplitude / amplitude.max() - 0.5
    last = int(np.flatnonzero(relative >= 0)[-1])
    if last + 1 == len(offsets):
        return float(offsets[last])
    fraction = relative[last] / (relative[last] - relative[last + 1])
    return float(offsets[last] + fraction * (offsets[last + 1] - offsets[last]))


def _sum(waves: NDArray[np.complex128], weights: NDArray[Any]) -> NDArray[np.complex128]:
    """Sum over elements: (points, elements) times (elements,) gives (points,).

    The product is too small to be worth the threads of a matrix product.
    """
    return np.einsum("pe,e->p", waves, weights)


def _pulse_spectrum(
    transducer: Transducer, imaging: ImagingParameters
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return wavenumbers within the band in rad/m, and the spectrum's amplitude there."""
    centre = imaging.transmit_frequency
    frequency = centre * (
        1 + transducer.fractional_bandwidth * np.linspace(-0.6, 0.6, _FREQUENCIES)
    )
    spectrum = transmitted_spectrum(frequency, centre, transducer.fractional_bandwidth)
    return 2 * np.pi * frequency / imaging.sound_speed, spectrum


def lateral_width(depth: float, transducer: Transducer, imaging: ImagingParameters) -> float:
    """Return the full width at half amplitude of the pulse-echo beam along the array, in m.

    The beam is the product of transmission with a fixed focus and reception with a Hann window and
    dynamic focusing. Both are summed over the elements of the arc with their directivity, and over
    the spectrum.
    """
    position = (np.arange(transducer.elements) - (transducer.elements - 1) / 2) * (
        transducer.element_pitch
    )
    radius = transducer.array_radius
    if radius > 0:
        tilt = position / radius
        x, y = radius * np.sin(tilt), radius * (np.cos(tilt) - 1)
    else:
        tilt = np.zeros_like(position)
        x, y = position, np.zeros_like(position)
    focus = imaging.focus_depth
    widest = transducer.transmit_elements * transducer.element_pitch
    transmit = (np.abs(position) <= min(widest, focus / transducer.transmit_f_number) / 2) * 1.0
    aperture = np.clip(
        depth / transducer.receive_f_number,
        4 * transducer.element_pitch,
        transducer.receive_elements * transducer.element_pitch,
    )
    receive = np.where(
        np.abs(position) < aperture / 2, np.cos(np.pi * position / aperture) ** 2, 0.0
    )
    reach = 6 * imaging.wavelength * max(depth / aperture, 1.0) + 0.1 * depth
    offsets = np.linspace(0, reach, _OFFSETS)
    dx = offsets[:, np.newaxis] - x
    dy = np.broadcast_to(depth - y, dx.shape)
    distance = np.hypot(dx, dy)
    angle = np.arctan2(dx, dy) - tilt
    energy = np.zeros(_OFFSETS)
    for wavenumber, spectrum in zip(*_pulse_spectrum(transducer, imaging), strict=True):
        phase = wavenumber * transducer.element_width * np.sin(angle) / (2 * np.pi)
        directivity = np.maximum(np.cos(angle), 0) * np.sinc(phase)
        waves = directivity * np.exp(1j * wavenumber * distance) / np.sqrt(distance)
        sent = _sum(waves, transmit * np.exp(-1j * wavenumber * np.hypot(x, focus - y)))
        received = _sum(waves, receive * np.exp(-1j * wavenumber * np.hypot(x, depth - y)))
        energy += np.abs(spectrum * sent * received) ** 2
    return 2 * _half_width(offsets, np.sqrt(energy))


def elevation_width(
    depth: float, transducer: Transducer, imaging: ImagingParameters
) -> tuple[float, float]:
    """Return the full width at half amplitude in m and the wave front's curvature in 1/m.

    Both are in elevation. A single aperture transmits and receives through one lens, so the
    pulse-echo beam is the square of its beam.
    """
    elements = 64
    height = transducer.element_height
    z = ((np.arange(elements) + 0.5) / elements - 0.5) * height
    delay = np.hypot(z, transducer.lens_focus)
    reach = 4 * imaging.wavelength * depth / height + 1.2 * height
    offsets = np.linspace(0, reach, _OFFSETS)
    distance = np.hypot(offsets[:, np.newaxis] - z, depth)
    energy = np.zeros(len(offsets))
    for wavenumber, spectrum in zip(*_pulse_spectrum(transducer, imaging), strict=True):
        waves = _sum(np.exp(1j * wavenumber * distance), np.exp(-1j * wavenumber * delay))
        energy += np.abs(spectrum * waves**2) ** 2
    half_width = _half_width(offsets, np.sqrt(energy))
    wavenumber = 2 * np.pi / imaging.wavelength
    waves = _sum(np.exp(1j * wavenumber * distance), np.exp(-1j * wavenumber * delay))
    near = offsets <= half_width
    path = np.unwrap(np.angle(waves[near] / waves[0])) / wavenumber
    weight = np.abs(waves[near]) ** 2 * offsets[near] ** 2
    curvature = 2 * np.sum(weight * path) / np.sum(weight * offsets[near] ** 2)
    return 2 * half_width, float(curvature)


_BEAMS: dict[str, Beam] = {}
"""Beams by the text of the settings they belong to, the oldest first."""


def beam_profile(
    transducer: Transducer, imaging: ImagingParameters, geometry: SweepGeometry
) -> Beam:
    """Return the widths of the beam at every sample's depth, cached by the settings."""
    # The settings are not hashable; their text holds every digit.
    key = f"{transducer} {imaging} {geometry}"
    if key not in _BEAMS:
        while len(_BEAMS) >= _MOST_BEAMS:
            del _BEAMS[next(iter(_BEAMS))]
        _BEAMS[key] = _beam_profile(transducer, imaging, geometry)
    return _BEAMS[key]


def _beam_profile(
    transducer: Transducer, imaging: ImagingParameters, geometry: SweepGeometry
) -> Beam:
    sample_depths = geometry.sample_pitch * np.arange(geometry.samples)
    shallowest = 2 * imaging.wavelength
    depths = np.linspace(shallowest, max(geometry.depth, 2 * shallowest), _DEPTHS)
    lateral = [lateral_width(depth, transducer, imaging) for depth in depths]
    elevation, curvature = np.transpose(
        [elevation_width(depth, transducer, imaging) for depth in depths]
    )

    def resampled(values: NDArray[np.float64] | list[float]) -> NDArray[np.float64]:
        # Smoothed: near the face, the width at half amplitude jumps between side lobes.
        return np.interp(sample_depths, depths, gaussian_filter1d(values, 1.0))

    width = axial_width(
        imaging.transmit_frequency, transducer.fractional_bandwidth, imaging.sound_speed
    )
    return Beam(
        wavelength=imaging.wavelength,
        axial=width / FWHM_PER_SIGMA,
        lateral=resampled(lateral) / FWHM_PER_SIGMA,
        elevation=resampled(elevation) / FWHM_PER_SIGMA,
        curvature=resampled(curvature),
        side_lobes=transducer.side_lobe_level,
    )


def point_spread(beam: Beam, geometry: SweepGeometry) -> PointSpread:
    """Return the widths of a beam as images carry them, at fewer depths."""
    samples = geometry.sample_pitch * np.arange(geometry.samples)
    depth = np.linspace(0, geometry.depth, _DEPTHS)
    lateral, elevation = (
        FWHM_PER_SIGMA * np.interp(depth, samples, sigma)
        for sigma in (beam.lateral, beam.elevation)
    )
    return PointSpread(depth, lateral, elevation, np.full(_DEPTHS, FWHM_PER_SIGMA * beam.axial))
