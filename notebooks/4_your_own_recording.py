# %% [markdown]
# # Your own recording
#
# The tracker accepts volumes from any source: files of 3D Slicer and PLUS, or your own arrays.
# Here, a simulated run stands in for your scanner. To use your own file, set `MINE` to its path.

# %%
# %matplotlib inline
import os
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.math import RigidTransform

from sonoservo.diagrams import load_scenario, locate, run, track, track_recording
from sonoservo.systems.display import Console
from sonoservo.systems.evaluation import picture_planes, plot_planes
from sonoservo.systems.recording import Recording
from sonoservo.systems.signals import Volume

MINE = None

# %%
folder = tempfile.TemporaryDirectory()
path = Path(MINE or f"{folder.name}/simulated.seq.nrrd")
if MINE is None:
    slow = "duration=20 hand.pushes.0.speed=0.005"
    changes = os.environ.get("SONOSERVO_QUICK", slow).split()
    run(load_scenario("chatelain2013_fig4", changes=changes), record=path)
    for each in sorted(path.parent.iterdir()):
        print(f"{each.name}: {each.stat().st_size / 1e6:.1f} MB")

# %% [markdown]
# A `Recording` reads one volume at a time. A file contains its grid and times. Give whatever it
# lacks as arguments: `depth` is the direction of the sound in the file's space, `window` the
# numbers that become black and white, `volume_rate` the number of volumes per second.

# %%
recording = Recording(path)
volume = recording[len(recording) - 1]
print(f"{len(recording)} volumes of {volume.intensities.shape}, {1e3 * volume.spacing} mm")
print(f"from {recording.times[0]:.2f} to {recording.times[-1]:.2f} s; poses: {recording.posed}")

# %% [markdown]
# Track the needle and watch the console. In a terminal, use
# `sonoservo track simulated.seq.nrrd --show`.

# %% tags=["remove-output"]
console = Console()
console

# %%
tracked = track_recording(recording, console=console)
print("volumes by mode:", tracked.summary["modes"])

# %% [markdown]
# Estimates are `NeedleEstimate`s in the world frame W; `tracked.rows` holds them in the file's own
# coordinates (LPS, mm). Check how the tip advances, and whether it ever jumps.

# %%
times = [row["time_s"] for row in tracked.rows]
plt.figure(figsize=(9, 3))
for axis, name in zip("lps", ("left", "posterior", "superior"), strict=True):
    plt.plot(times, [row[f"tip_{axis}_mm"] for row in tracked.rows], ".-", label=name)
plt.xlabel("time (s)")
plt.ylabel("estimated tip (mm)")
plt.legend()
plt.show()
# %% [markdown]
# The two orthogonal planes through the needle in a few volumes, along the beam (top) and across it
# (bottom); the middle planes where no needle is tracked:

# %%
shown = [k for k, each in enumerate(tracked.estimates) if each.curve] or range(len(recording))
chosen = np.array(shown)[np.linspace(0, len(shown) - 1, 4).astype(int)]
plot_planes(
    [
        picture_planes(recording[k], tracked.estimates[k].mode, tracked.estimates[k].curve)
        for k in chosen
    ]
)

# %% [markdown]
# Your own arrays need no file. Their index is `[x, y, z]` with the depth along `y`, their grey
# levels from 0 to 255 span 60 dB, and lengths are in m. `locate` finds the needle in one of them;
# `track` follows it through many.

# %%
arrays = [each.intensities for each in recording]
found = locate(arrays[-1], volume.spacing, origin=volume.origin)
print("tip in the array's coordinates, mm:",
      np.round(1e3 * found.curve.tip, 1) if found else found.reason)  # fmt: skip
volumes = (
    Volume(array, volume.origin, volume.spacing, RigidTransform(), time)
    for array, time in zip(arrays, recording.times, strict=True)
)
estimates = list(track(volumes))  # or one by one, as your scanner acquires the volumes
last = estimates[-1]
print(f"{last.mode}:", np.round(1e3 * last.curve.tip, 1) if last.curve else last.reason)
