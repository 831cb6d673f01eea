"""From received 2D frames with poses to volumes, one for each sweep of the probe."""

from typing import Any

from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.systems.live.image_matcher import PosedImage
from sonoservo.systems.live.volume_maker import ImagesToVolumes, grey_scale
from sonoservo.systems.recording.grey_levels import GreyLevels, void_flags
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.frame_reconstruction import (
    PosedFrame,
    SweepSplitter,
    reconstruct,
)


def frame_levels(posed: PosedImage, grey: GreyLevels) -> NDArray[Any]:
    """Return the (ni, nj) grey levels of a frame, black if not seen; a ValueError if all is."""
    pixels = posed.image.voxels[..., 0]
    void = void_flags(pixels)
    if void is not None and void.all():
        raise ValueError("a frame holds nothing but values that stand for what was not seen")
    return grey(pixels, void)


class FramesToVolumes(ImagesToVolumes):
    """Makes a volume of the frames between two turns of the probe, or of so many ``frames``.

    The second axis of a frame runs away from the probe. W is the frame that the poses lead to. See
    `GreyLevels` for the window; 60 dB from black to white are the default, and voxels have a
    spacing in m. ValueError if one of them is not allowed.
    """

    takes_frames = True

    def __init__(
        self,
        *,
        window: tuple[float, float] | None = None,
        dynamic_range_db: float | None = None,
        frames: int | None = None,
        spacing: float = 7e-4,
    ) -> None:
        super().__init__(window)
        self._scale = grey_scale(dynamic_range_db)
        self._splitter = SweepSplitter(frames=frames)
        self._spacing = spacing

    def _make(self, posed: PosedImage) -> Volume | NotFound:
        X_WI = posed.X_WL.GetAsMatrix4() @ posed.image.X_LI
        sweep = self._splitter.add(PosedFrame(frame_levels(posed, self.grey), X_WI, posed.time))
        if not sweep:
            return NotFound("")
        return reconstruct(sweep, spacing=self._spacing, decibels_per_level=self._scale)

    def X_WL(self, posed: PosedImage) -> RigidTransform:
        """Pose in W of the frame that results are told in: the reference itself."""
        return RigidTransform()
