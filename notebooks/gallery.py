"""Gallery of needles: a notebook (jupytext percent format) that also runs as a script."""

# %% [markdown]
# # Images of the simulated scanner
#
# A needle under the probe at five angles to the beam's normal: a smooth one in agar, the same
# without reverberation and in tissue, and one with dimples. Then the same needle across the frames
# of a probe that moves during the sweep, and how much kinds of needles stand out by angle.

# %%
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from needle_echo import measure_needle_echo
from pydrake.math import RigidTransform, RotationMatrix

from sonoservo.diagrams import load_scenario, scan
from sonoservo.systems.needle.insertion_parameters import OUTER_DIAMETER
from sonoservo.systems.signals import Needle, Plane, sample_sector
from sonoservo.systems.ultrasound import ImagingParameters, Transducer
from sonoservo.systems.ultrasound.simulation import (
    ScannerParameters,
    SweepRenderer,
    Tissue,
    load_needle,
)

ANGLES = [0, 5, 10, 20, 40]
DEPTH = 0.045
PROBE = RigidTransform(RotationMatrix.MakeXRotation(-np.pi / 2), [0, 0, -0.004])
FINE = "scan_conversion.spacing=[0.0003, 0.0003, 0.0006]"


# %%
def needle_at(dip_deg, azimuth_deg, *changes, velocity=(0, 0, 0)):
    """Acquire one sweep over a needle that reaches 15 mm beyond the middle of the beam."""
    dip, azimuth = np.deg2rad([dip_deg, azimuth_deg])
    direction = np.array(
        [np.cos(dip) * np.cos(azimuth), np.cos(dip) * np.sin(azimuth), -np.sin(dip)]
    )
    entry = (np.array([0, 0, -DEPTH]) - 0.045 * direction).tolist()
    insertion = [
        f"hand.entry={entry}",
        f"hand.dip_deg={dip_deg}",
        f"hand.azimuth_deg={azimuth_deg}",
    ]
    still = ["hand.entry_spread=[0, 0, 0]", "hand.angle_spread_deg=0", "hand.tremor=0"]
    pushes = ["hand.start=0", "hand.pushes=[{duration: 6, speed: 0.01}]", "imaging.gain=0.36"]
    scenario = load_scenario(
        "chatelain2013_fig5", changes=[FINE, *insertion, *still, *pushes, *changes]
    )
    return scenario, scan(scenario, time=8.0, X_TP=PROBE, velocity=velocity)


# %% [markdown]
# The image along needle and beam. The numbers below each image are the level above the tissue, the
# length that stands out by 12 dB, and the thickness at -20 dB.

# %%
ROWS = {
    "as it is": [],
    "no reverberation": ["scanner.needle.reverberation_db=-90"],
    "in tissue": ["phantom=rough"],
    "dimpled, in tissue": ["phantom=rough", "needle=echogenic"],
}
shown = {row: [needle_at(angle, 0, *changes) for angle in ANGLES] for row, changes in ROWS.items()}
figures = {
    row: [
        measure_needle_echo(s.sweep, s.volume.to_probe(s.needle.shaft), scenario.imaging)
        for scenario, s in scans
    ]
    for row, scans in shown.items()
}

# %% [markdown]
# The image across the beam at the needle's depth, of a needle that lies across the frames while the
# probe moves along the array.

# %%
MOVING = {
    "probe at rest": ([], 0.0),
    "probe moving at 20 mm/s": ([], 0.02),
    "moving, compensated": (["scan_conversion.compensate_motion=true"], 0.02),
}
moved = {
    name: needle_at(0, 60, *changes, velocity=(speed, 0, 0))
    for name, (changes, speed) in MOVING.items()
}

# %%
INK, QUIET, PAPER, LINE = "#F2F2F2", "#9AA4AD", "#0E1116", "#FFB000"
LONG = Plane(RigidTransform([0, 0.041, 0]), width=0.076, height=0.066)
FLAT = Plane(RigidTransform(RotationMatrix.MakeXRotation(np.pi / 2), [0, 0.041, 0]), 0.046, 0.0276)


def show(axes, volume, plane):
    """Draw a slice in mm."""
    picture = sample_sector(volume, plane, 0.3e-3).astype(float)
    image = np.where(picture[..., 1] > 0, picture[..., 0], np.nan)
    half_width, half_height = 500 * plane.width, 500 * plane.height
    axes.imshow(
        image, cmap="gray", vmin=0, vmax=255, interpolation="bilinear",
        extent=(-half_width, half_width, half_height, -half_height),
    )  # fmt: skip
    axes.set_facecolor(PAPER)
    axes.set(xticks=[-20, 0, 20], yticks=[])
    axes.tick_params(colors=QUIET, labelsize=7)
    axes.spines[:].set_visible(False)


# %%
figure = plt.figure(figsize=(13, 12.8), facecolor=PAPER, layout="constrained")
grid = figure.add_gridspec(5, 5, height_ratios=[1, 1, 1, 1, 0.9])
for i, (row, scans) in enumerate(shown.items()):
    for j, ((_, s), echo) in enumerate(zip(scans, figures[row], strict=True)):
        axes = figure.add_subplot(grid[i, j])
        show(axes, s.volume, LONG)
        axes.set_title(f"{ANGLES[j]}°" if i == 0 else "", color=INK, fontsize=12)
        axes.set_ylabel(row if j == 0 else "", color=INK, fontsize=10)
        thick = f"{1e3 * echo.thickness:.1f} mm thick" if echo.peak_db > 20 else "too faint"
        figures_text = f"{echo.peak_db:.0f} dB   {1e3 * echo.visible_length:.0f} mm   {thick}"
        axes.set_xlabel(figures_text, color=LINE, fontsize=8.5)
for j, (name, (_, s)) in enumerate(moved.items()):
    axes = figure.add_subplot(grid[4, j])
    show(axes, s.volume, FLAT)
    ends = 1e3 * s.volume.to_probe(s.needle.shaft)
    middle = ends.mean(axis=0)
    for offset in (-3, 3):
        axes.axline(
            middle[[0, 2]] + [offset, 0], ends[1][[0, 2]] + [offset, 0],
            color=LINE, linewidth=1, linestyle=":",
        )  # fmt: skip
    axes.set_xlabel(name, color=LINE, fontsize=8.5)
    axes.set_ylabel("across the beam" if j == 0 else "", color=INK, fontsize=10)
axes = figure.add_subplot(grid[4, 3:], facecolor=PAPER)
for angle, echo, shade in zip(
    ANGLES, figures["as it is"], plt.cm.plasma(np.linspace(0.25, 0.95, 5)), strict=True
):
    axes.plot(1e3 * echo.distance - 45, echo.level_db, color=shade, label=f"{angle}°", linewidth=1)
axes.set(xlim=(-36, 16), ylim=(0, 46))
axes.set_title("level along the needle, dB over the tissue", color=INK, fontsize=9.5)
axes.set_xlabel("from the middle of the beam, mm", color=LINE, fontsize=8.5)
axes.tick_params(colors=QUIET, labelsize=7)
axes.tick_params(axis="y", direction="in", pad=-15)
axes.spines[:].set_color(QUIET)
axes.legend(frameon=False, labelcolor=INK, fontsize=8.5, ncols=5, loc="upper center")
figure.suptitle(
    "A needle at 0 to 40° to the normal of the beam. Below each image: level above the tissue, "
    "length that stands out by 12 dB, thickness at -20 dB",
    color=INK,
)
figure.savefig("gallery.png", dpi=58, pil_kwargs={"optimize": True})
plt.close(figure)
print(f"written: {Path('gallery.png').resolve()}")

# %% [markdown]
# Mean level of five kinds of needles over the tissue, 50 mm deep, against the angle to the beam's
# normal. Crosses: grey above the background as Nichols et al. (2003) measured it at 15 deg between
# needle and beam, as a share of that across the beam, read as dB.

# %%
KINDS = ["biopsy", "spinal", "brachytherapy", "coated", "echogenic"]
TILTS = [0, 2, 4, 6, 8, 10, 15, 20, 30, 40, 50, 60, 75]
NICHOLS = {"echogenic": 40 / 68, "coated": 9 / 68, "biopsy": 5 / 68}
WHITE_DB = 38.0  # from the tissue's grey to white


def contrast_db(kind, tilt_deg, places=8):
    """Mean intensity of a needle's echo over the tissue's, in dB."""
    needle, tilt = load_needle(kind), np.deg2rad(tilt_deg)
    renderer = SweepRenderer(
        transducer=Transducer(),
        imaging=ImagingParameters(frames=3, volume_rate=20, sector=0.1),
        tissue=Tissue(size=[0.4, 0.4, 0.2]),
        parameters=ScannerParameters(needle=replace(needle.echo, shadow=0.0)),
        seed=0,
    )
    X = np.repeat(PROBE.GetAsMatrix4()[np.newaxis], 3, axis=0)
    tissue, powers = renderer.tissue_echo(X, 1)[1], []
    for half in 0.015 + 1.1e-3 * np.arange(places):
        ends = np.outer([-half, half], [np.cos(tilt), 0, -np.sin(tilt)]) - [0, 0, 0.055]
        held = Needle(ends, OUTER_DIAMETER[needle.gauge] / 2)
        echo = np.abs(renderer.echo(X, [held] * 3, 1)[1] - tissue)
        middle = renderer.geometry.lines // 2
        powers.append((echo[middle - 1 : middle + 2, 130:200].max(axis=1) ** 2).mean())
    return 10 * np.log10(np.mean(powers))


contrast = {kind: [contrast_db(kind, tilt) for tilt in TILTS] for kind in KINDS}
figure, axes = plt.subplots(figsize=(7.5, 4.2), layout="constrained")
for kind, levels in contrast.items():
    (line,) = axes.plot(TILTS, levels, marker=".", label=kind)
    if kind in NICHOLS:
        axes.plot(75, NICHOLS[kind] * WHITE_DB, "x", color=line.get_color(), markersize=9)
axes.axhline(0, color="0.6", linewidth=1)
axes.set(
    xlabel="angle to the normal of the beam, deg", ylabel="over the tissue, dB", ylim=(-20, 45)
)
axes.legend(frameon=False)
figure.savefig("needles.png", dpi=90, pil_kwargs={"optimize": True})
plt.close(figure)
print(f"written: {Path('needles.png').resolve()}")
