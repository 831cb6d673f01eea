"""Tracked 2D frames of a known scene, and the files that PLUS would make of them."""

from pathlib import Path

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from sonoservo.systems.ultrasound.frame_reconstruction import PosedFrame

SIZE = 40, 50
PIXEL = np.diag([0.5e-3, 0.4e-3, 1e-3, 1.0])


def grey(p_W) -> np.ndarray:
    """A scene that trilinear interpolation gives back exactly."""
    return 120 + np.asarray(p_W) @ [1500, 900, -1300]


def look(X_WF: RigidTransform, time: float, dtype=np.float32) -> PosedFrame:
    """The frame that is seen from a pose."""
    ni, nj = SIZE
    X_FI = PIXEL.copy()
    X_FI[0, 3] = -0.5 * PIXEL[0, 0] * (ni - 1)
    X_WI = X_WF.GetAsMatrix4() @ X_FI
    i, j = np.meshgrid(np.arange(ni), np.arange(nj), indexing="ij")
    index = np.stack([i, j, 0 * i, 1 + 0 * i], axis=-1)
    pixels = grey((index @ X_WI.T)[..., :3])
    return PosedFrame((np.rint(pixels) if dtype == np.uint8 else pixels).astype(dtype), X_WI, time)


def freehand(count: int = 30, *, turns: int = 0, start: float = 10.0, dtype=np.float32):
    """Frames of a hand that sweeps, and trembles, with so many turns."""
    frames = []
    for number in range(count * (turns + 1)):
        sweep, at = divmod(number, count)
        along = at if sweep % 2 == 0 else count - 1 - at
        tremble = RollPitchYaw(0.01 * (along - count / 2), 0.03 * np.sin(along / 5), 0.02)
        X_WF = RigidTransform(tremble, [0.002 * np.sin(along / 7), 0.001, 0.0006 * along])
        frames.append(look(X_WF, start + 0.05 * number, dtype))
    return frames


def write_plus_file(path: Path, frames, *, name="ImageToReference", bad=(), header="") -> Path:
    """Write frames as PLUS does, ``.igs.mha``."""
    ni, nj = frames[0].pixels.shape
    lines = [
        "ObjectType = Image",
        "NDims = 3",
        "BinaryData = True",
        "BinaryDataByteOrderMSB = False",
        "CompressedData = False",
        "TransformMatrix = 1 0 0 0 1 0 0 0 1",
        "Offset = 0 0 0",
        "ElementSpacing = 1 1 1",
        f"DimSize = {ni} {nj} {len(frames)}",
        "ElementType = MET_UCHAR",
        "UltrasoundImageOrientation = MF",
    ]
    for k, frame in enumerate(frames):
        matrix = np.diag([1e3, 1e3, 1e3, 1.0]) @ frame.X_WI
        text = " ".join(f"{x:.12g}" for x in matrix.ravel())
        lines += [
            f"Seq_Frame{k:04d}_{name}Transform = {text}",
            f"Seq_Frame{k:04d}_{name}TransformStatus = {'INVALID' if k in bad else 'OK'}",
            f"Seq_Frame{k:04d}_Timestamp = {frame.time:.6f}",
            f"Seq_Frame{k:04d}_ImageStatus = OK",
        ]
    lines += [*header.splitlines(), "ElementDataFile = LOCAL", ""]
    data = b"".join(frame.pixels.astype(np.uint8).tobytes(order="F") for frame in frames)
    path.write_bytes("\n".join(lines).encode() + data)
    return path
