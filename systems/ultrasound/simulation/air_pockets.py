"""Air pockets between a probe's face and the skin, which come and go."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d
from scipy.special import ndtri

from sonoservo.systems.signals.requirements import (
    Bounded,
    Positive,
    at_least,
    within,
)
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.transducer import Transducer

_WAVES = 128
_ELEVATIONS = 7


@dataclass(kw_only=True)
class AirPocketParameters(Bounded):
    """Parameters of the air between face and skin, which reflects all sound.

    Parameters
    ----------
    share
        Share of the face under which air lies, on average over place and time; 0 for none.
    size
        Distance on the face over which air and gel alternate, in m.
    period
        Time over which air pockets come and go, in s.
    """

    share: Annotated[float, within(0, 0.9)] = 0.0
    size: Annotated[float, at_least(0.001, " m")] = 8e-3
    period: Positive = 4.0


class AirPockets:
    """Air under a probe's face, at the places where a smooth random field is high.

    The field is Gaussian with the correlation exp(-d^2 / 2 size^2 - t^2 / 2 period^2) over a
    distance d and a time t. No sound passes the air, which acoustically is nearly a vacuum. The
    sound that reaches the focus, and that returns from it, is the sum over the open part of either
    aperture.
    """

    def __init__(
        self,
        parameters: AirPocketParameters,
        transducer: Transducer,
        imaging: ImagingParameters,
        geometry: SweepGeometry,
        rng: np.random.Generator,
    ) -> None:
        self._threshold = float(ndtri(1 - parameters.share)) if parameters.share else np.inf
        across, self._along = rng.normal(size=(2, _WAVES)) / parameters.size
        self._in_time = rng.normal(size=_WAVES) / parameters.period
        self._phase = rng.uniform(0, 2 * np.pi, _WAVES)
        self._geometry = geometry
        self._elements = transducer.element_pitch * _centred(transducer.elements)
        self._across = np.exp(1j * np.multiply.outer(across, self._elements))
        self._height = transducer.element_height
        focus, pitch = imaging.focus_depth, transducer.element_pitch
        sent = min(transducer.transmit_elements * pitch, focus / transducer.transmit_f_number)
        back = min(transducer.receive_elements * pitch, focus / transducer.receive_f_number)
        self._sent = _aperture(sent / pitch, hann=False)
        self._back = _aperture(back / pitch, hann=True)
        first, second = geometry.position(0, np.array([0, 1]), 0, 1)
        self._lines = float(np.linalg.norm(second - first)) * _centred(geometry.lines)

    def open_shares(
        self, times: NDArray[np.float64], part: slice = slice(None)
    ) -> NDArray[np.float32]:
        """Return the (n, lines) factors on echoes of n frames; see `air` for the arguments."""
        shares = np.ones((len(times), self._geometry.lines), np.float32)
        if np.isfinite(self._threshold):
            is_open = ~self.air(times, part)
            sent, back = (
                convolve1d(is_open.mean(axis=1), aperture, axis=1, mode="nearest")
                for aperture in (self._sent, self._back)
            )
            for frame, both in enumerate(sent * back):
                shares[frame] = np.interp(self._lines, self._elements, both)
        return shares

    def air(self, times: NDArray[np.float64], part: slice = slice(None)) -> NDArray[np.bool_]:
        """Return True under air, (n, elevations, elements), at (n,) times in s of frames."""
        geometry = self._geometry
        swept = geometry.motor_radius * geometry.frame_pitch * _centred(geometry.frames)
        places = swept[part, np.newaxis] + self._height / _ELEVATIONS * _centred(_ELEVATIONS)
        turns = np.multiply.outer(places, self._along) + self._phase
        turns += np.multiply.outer(times, self._in_time)[:, np.newaxis]
        field = (np.exp(1j * turns) @ self._across).real * np.sqrt(2 / _WAVES)
        return np.asarray(field > self._threshold)


def _centred(count: int) -> NDArray[np.float64]:
    """Return successive whole or half numbers around 0."""
    return np.arange(count, dtype=np.float64) - (count - 1) / 2


def _aperture(elements: float, hann: bool) -> NDArray[np.float64]:
    """Return the weights of an aperture's elements, whose sum is 1."""
    place = _centred(2 * max(int(elements / 2), 1) + 1)
    weights = np.cos(np.pi * place / (len(place) + 1)) ** 2 if hann else np.ones(len(place))
    return np.asarray(weights / weights.sum())
