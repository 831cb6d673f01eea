# %% [markdown]
# # Your own probe
#
# A YAML file describes the hardware of a probe. Write your own, look at its beam and at the image
# of a needle, and give it to the robot. No file of the package needs to change.

# %%
# %matplotlib inline
import os
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from sonoservo.diagrams import load_scenario, run, scan
from sonoservo.systems.display import slice_views
from sonoservo.systems.signals import sample_plane
from sonoservo.systems.ultrasound import elevation_width, lateral_width, load_transducer

# %% [markdown]
# A probe has a transducer and a body. Fields missing from the file keep the values of the
# Ultrasonix 4DC7-3/40 (Chatelain 2013). If the body is missing, it is assumed to have a dome curved
# like the transducer's face. Here is an abdominal probe, which is flatter and wider. Lengths are in
# m, frequencies in Hz. If there is a mistake, the error names the field, its value and what is
# allowed.

# %%
folder = tempfile.TemporaryDirectory()
file = Path(folder.name) / "abdominal.yaml"
file.write_text("""
transducer:
  array_radius: 0.060
  motor_radius: 0.050
  line_pitch_deg: 0.5
  element_pitch: 0.5e-3
  element_width: 0.45e-3
""")
probes = {"4DC7-3/40": "4dc7_3_40", "abdominal": str(file)}

# %% [markdown]
# The full width of its beam at half amplitude (-6 dB, two-way) over depth follows from the aperture
# integrals. Where the beam is wide, a needle looks thick and its tip is blurred. In elevation both
# probes have the same lens, so their curves coincide.

# %%
imaging = load_scenario("chatelain2013_fig5").imaging
depths = np.linspace(0.015, 0.085, 15)
figure, (lateral, elevation) = plt.subplots(1, 2, figsize=(9, 3), sharey=True)
for name, probe in probes.items():
    hardware = load_transducer(probe)
    across = [lateral_width(depth, hardware, imaging) for depth in depths]
    along_the_sweep = [elevation_width(depth, hardware, imaging)[0] for depth in depths]
    lateral.plot(1e3 * depths, 1e3 * np.array(across), label=name)
    elevation.plot(1e3 * depths, 1e3 * np.array(along_the_sweep))
lateral.set_title("Beam, lateral")
lateral.set_ylabel("width (mm)")
lateral.legend()
elevation.set_title("Beam, in elevation")
for axes in (lateral, elevation):
    axes.set_xlabel("depth (mm)")
    axes.grid(alpha=0.3)

# %% [markdown]
# One sweep with each probe over the same needle in the same tissue, without a robot:

# %%
scans = {
    name: scan(load_scenario("chatelain2013_fig4", changes=[f"probe={probe}"]), time=20.0)
    for name, probe in probes.items()
}

# %% [markdown]
# The planes Z = 0 and X = 0 of the probe, as the console shows them. Grey levels span
# 60 dB.

# %%
figure, axes = plt.subplots(
    2, 2, figsize=(9, 6.5), sharey=True, width_ratios=[3, 1], layout="constrained"
)
for row, (name, shown) in zip(axes, scans.items(), strict=True):
    for axis, view, across in zip(row, slice_views(shown.volume), "ZX", strict=True):
        (left, top), (right, bottom) = 1e3 * view.window
        grey = sample_plane(shown.volume, view.plane, 0.5e-3)
        half = 500 * np.array([view.plane.width, view.plane.height])
        x, y = 1e3 * view.coordinates(view.plane.X_PS.translation())
        axis.imshow(
            grey,
            "gray",
            vmin=0,
            vmax=255,
            extent=(x - half[0], x + half[0], y + half[1], y - half[1]),
        )
        axis.set_xlabel("mm")
        axis.set_title(f"plane {across} = 0")
    row[0].set_ylabel(f"{name}: depth (mm)")

# %% [markdown]
# To use it in the loop, name the file as the scenario's probe. The volumes carry the width of the
# beam at every depth, so the tracker knows how much the needle's end is blurred.

# %%
beam_width = lateral_width(0.05, load_transducer(file), imaging)
changes = [f"probe={file}", *os.environ.get("SONOSERVO_QUICK", "duration=20").split()]
result = run(load_scenario("chatelain2013_fig5", changes=changes))
print(f"beam {1e3 * beam_width:.2f} mm wide at 50 mm")
found, errors = result.summary["detection"], result.summary["tracking"]["tip_error_mm"]
if found["volume"] is not None:
    print(f"found in volume {found['volume']}, with {found['visible_mm']:.0f} mm of needle in view")
    print(f"tip {errors['median']:.2f} mm off (median), {errors['p95']:.2f} mm (95 %)")
