"""Gallery of structures and dials, as a notebook (percent format) that also runs as a script."""

# %% [markdown]
# # What makes an image hard
#
# Each structure, and each dial of the needle, of the acoustics, of the tissue's motion and of the
# scanner, at three strengths beside the clean image: the middle frame of one sweep. What the
# scanner's motor and its connection do shows from frame to frame: the middle lines of all frames,
# with a needle across.

# %%
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from pydrake.math import RigidTransform

from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.sweep import SweepMotion
from sonoservo.systems.ultrasound.imaging import ImagingParameters
from sonoservo.systems.ultrasound.simulation import (
    AirPocketParameters,
    Ball,
    ConnectionParameters,
    MotorParameters,
    NeedleEchoParameters,
    ScannerParameters,
    SweepRenderer,
    Tissue,
    acquire_sweep,
    load_needle,
    load_tissue,
)
from sonoservo.systems.ultrasound.simulation.reaction.deformation import Deformation, Indentation
from sonoservo.systems.ultrasound.simulation.structures.kinds import (
    Bone,
    Calcification,
    Fascia,
    FatLayer,
    Gas,
    NWires,
    RestingNeedle,
    Vessel,
)
from sonoservo.systems.ultrasound.transducer import load_transducer

ON_TOP = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, -0.004], [0, 0, 0, 1.0]])
ACROSS = np.array([[0, 0, 1, 0], [1, 0, 0, 0], [0, -1, 0, -0.004], [0, 0, 0, 1.0]])
IMAGING = ImagingParameters(frames=3, volume_rate=20, gain=0.36)
PLAIN, ECHO = Tissue(seed=1), NeedleEchoParameters()
BARE = {"noise_db": -70, "gain_error_db": 0, "clutter_db": -300, "decorrelation": 0}
NONE = Needle(np.zeros((0, 3)), 0.635e-3)


def held(dip_deg):
    """A needle whose tip is below the middle of the probe."""
    dip = np.deg2rad(dip_deg)
    tip = np.array([0.012, 0, -0.047])
    return Needle(np.array([tip - 0.055 * np.array([np.cos(dip), 0, -np.sin(dip)]), tip]), 0.635e-3)


def frame(
    tissue,
    needle=NONE,
    echo=ECHO,
    x=0.0,
    pose=ON_TOP,
    air=0.0,
    pressed=0.0,
    deformation=None,
    times=(0.0,),
    **scanner,
):
    """The mean of the middle frames of sweeps, and where its samples lie in mm."""
    renderer = SweepRenderer(
        transducer=load_transducer("4dc7_3_40"),
        imaging=IMAGING,
        tissue=tissue,
        parameters=ScannerParameters(
            needle=echo, air_pockets=AirPocketParameters(share=air, size=6e-3), **scanner
        ),
        seed=0,
    )
    X = np.repeat(pose[np.newaxis], 3, axis=0)
    X[:, 0, 3] = x
    X[:, 2, 3] -= pressed
    deformations = None
    if deformation is not None:
        needle = deformation.moved_needle(needle)
        deformations = [deformation] * 3
    shown = [
        renderer.render(X, [needle] * 3, 1, 0, np.full(3, time), deformations)[1] for time in times
    ]
    grey = np.mean(shown, axis=0)
    j, i = np.indices(grey.shape)
    return grey, 1e3 * renderer.geometry.position(1, j, i, 1)


def across(directions=(1,), **errors):
    """The middle lines of all frames, averaged over sweeps, and where their samples lie in mm.

    A steep needle descends across the frames.
    """
    renderer = SweepRenderer(
        transducer=load_transducer("4dc7_3_40"),
        imaging=replace(IMAGING, frames=31, volume_rate=3, sector=0.1),
        tissue=PLAIN,
        parameters=ScannerParameters(needle=replace(ECHO, dimples_db=30.0), **errors),
        seed=0,
    )
    geometry = renderer.geometry
    needle = Needle(np.array([[0.0, 0.018, -0.02], [0.0, -0.018, -0.065]]), 0.635e-3)
    middle = geometry.lines // 2
    sweeps = [
        acquire_sweep(
            renderer,
            SweepMotion.at_rest(geometry, RigidTransform(ON_TOP), 0.0, direction),
            [needle] * geometry.frames,
        ).samples[:, middle]
        for direction in directions
    ]
    k, i = np.indices(sweeps[0].shape)
    return np.mean(sweeps, axis=0), 1e3 * geometry.position(k, middle, i, 1)[..., [2, 1]]


def having(*structures, **changes):
    """The middle frame of plain tissue with structures."""
    return frame(replace(PLAIN, structures=list(structures), **changes))


# %%
BEADS = replace(
    PLAIN,
    balls=[
        Ball(centre=[x, 0, z], radius=0.5e-3, level_db=32)
        for x in np.arange(-0.035, 0.04, 0.01)
        for z in np.arange(-0.065, -0.008, 0.007)
    ],
)


def pressed(newton, indents=True):
    """Beads and a needle below a probe that presses; the depth grows with the power 2/3."""
    depth = 4.3e-3 * (newton / 2) ** (2 / 3)
    contact = Indentation(0.0, 0.0, depth, 33e-3) if indents else Indentation()
    return frame(BEADS, held(8), pressed=depth - 4e-3, deformation=Deformation(contact))


def dragged(distance):
    """Beads beside a needle that drags them along."""
    deformation = Deformation(shaft=held(8).shaft, drag=distance)
    return frame(BEADS, held(8), deformation=deformation)


def pushed(radius):
    """Beads that give way to a needle."""
    needle = replace(held(0), radius=max(radius, 0.25e-3))
    return frame(BEADS, needle, deformation=Deformation(shaft=needle.shaft, hole_radius=radius))


def flowing(speed):
    """The mean of eight sweeps, in which moving blood loses its speckle."""
    vessel = Vessel(radius=6e-3, lumen_db=-6, pulsation=0, flow_speed=speed)
    tissue = replace(PLAIN, structures=[vessel])
    return frame(tissue, times=0.05 * np.arange(8))


FLAT = Fascia(centre=[0, 0, -0.05], wave_height=0)
ROWS = {
    "bone: 4, 12, 40 mm wide": [
        having(Bone(start=[0, -0.03, -0.04], end=[0, 0.03, -0.04], width=w))
        for w in (0.004, 0.012, 0.04)
    ],
    "vessel: radius 1.5, 3, 6 mm": [having(Vessel(radius=r)) for r in (1.5e-3, 3e-3, 6e-3)],
    "fascia: dip 0, 10, 25 deg": [having(Fascia(dip_deg=d)) for d in (0, 10, 25)],
    "calcification: radius 0.5, 1.5, 4 mm": [
        having(Calcification(radius=r)) for r in (0.5e-3, 1.5e-3, 4e-3)
    ],
    "gas: 5, 15, 40 mm": [having(Gas(size=[s, s])) for s in (0.005, 0.015, 0.04)],
    "N-wires: level 24, 34, 44 dB": [having(NWires(level_db=d)) for d in (24, 34, 44)],
    "needle at rest: 0.5, 0.9, 1.8 mm": [
        having(RestingNeedle(diameter=d)) for d in (0.5e-3, 0.9e-3, 1.8e-3)
    ],
    "fat: 5, 10, 20 mm over a flat sheet": [
        having(FLAT, fat=FatLayer(thickness=t)) for t in (0.005, 0.01, 0.02)
    ],
    "tissue at 1540, 1500, 1463 m/s": [
        having(FLAT, sound_speed=c) for c in (1540.0, 1500.0, 1463.0)
    ],
    "backlash 1, 2, 4 deg: mean of sweeps to and fro": [
        across((1, -1), motor=MotorParameters(backlash_deg=play)) for play in (1.0, 2.0, 4.0)
    ],
    "motor errs by 0.2, 0.5, 1 deg": [
        across(motor=MotorParameters(error_deg=error)) for error in (0.2, 0.5, 1.0)
    ],
    "frames lost: 5, 15, 40 %": [
        across(connection=ConnectionParameters(lost_frames=share)) for share in (0.05, 0.15, 0.4)
    ],
    "needle fades by 3, 6, 12 dB": [
        frame(PLAIN, held(8), replace(ECHO, fading_db=d)) for d in (3.0, 6.0, 12.0)
    ],
    "polished to 40, 20, 10 deg": [
        frame(PLAIN, held(40), replace(ECHO, diffuse_lobe_deg=d)) for d in (40.0, 20.0, 10.0)
    ],
    "dimples at 16, 22, 28 dB": [
        frame(PLAIN, held(40), replace(ECHO, diffuse_lobe_deg=15.0, dimples_db=d))
        for d in (16.0, 22.0, 28.0)
    ],
    "kinds at 40 deg: coated, dimpled, spinal": [
        frame(PLAIN, held(40), load_needle(kind).echo) for kind in ("coated", "echogenic", "spinal")
    ],
    "noise at -50, -40, -30 dB": [
        frame(PLAIN, held(8), **BARE | {"noise_db": n}) for n in (-50, -40, -30)
    ],
    "clutter at -20, -10, 0 dB": [
        frame(PLAIN, held(8), **BARE | {"clutter_db": c}) for c in (-20, -10, 0)
    ],
    "gain errs by 1.5, 3, 6 dB": [
        frame(PLAIN, held(8), **BARE | {"gain_error_db": g}) for g in (1.5, 3, 6)
    ],
    "agar: 12 dB darker, with imperfections, a console's": [
        frame(replace(PLAIN, level_db=-12.0, scatterers_per_cell=1), held(8), **BARE),
        frame(load_tissue("agar"), held(8), **BARE),
        frame(load_tissue("agar"), held(8)),
    ],
    "tip: bevel up, bevel down, blunt": [
        frame(PLAIN, held(8), replace(ECHO, tip=tip, tip_roll_deg=roll))
        for tip, roll in (("bevel", 0.0), ("bevel", 180.0), ("blunt", 0.0))
    ],
    "pressed with 1, 2, 4 N": [pressed(n) for n in (1.0, 2.0, 4.0)],
    "dragged by 1, 2, 5 mm": [dragged(d) for d in (1e-3, 2e-3, 5e-3)],
    "pushed aside by 22, 18, 14 gauge": [pushed(r) for r in (0.36e-3, 0.635e-3, 1.05e-3)],
    "breathing: 5, 10, 15 mm": [frame(BEADS, x=x) for x in (-0.005, -0.01, -0.015)],
    "blood at 3, 10, 100 mm/s, mean of 8": [flowing(v) for v in (0.003, 0.01, 0.1)],
    "air under 10, 25, 50 % of the face": [frame(PLAIN, air=share) for share in (0.1, 0.25, 0.5)],
    "skin curved by 120, 60, 45 mm": [
        frame(replace(PLAIN, size=[0.4, 2 * r, 2 * r], shape="cylinder"), pose=ACROSS)
        for r in (0.12, 0.06, 0.045)
    ],
    "a synthetic liver": [frame(load_tissue("liver"), x=x) for x in (-0.03, 0.0, 0.045)],
}

# %%
INK, PAPER = "#F2F2F2", "#0E1116"
clean = {name: having() for name in ROWS}
clean["needle fades by 3, 6, 12 dB"] = frame(PLAIN, held(8))
clean["tip: bevel up, bevel down, blunt"] = frame(PLAIN, held(8))
clean["pressed with 1, 2, 4 N"] = pressed(2.0, indents=False)
clean["dragged by 1, 2, 5 mm"] = dragged(0.0)
clean["pushed aside by 22, 18, 14 gauge"] = pushed(0.0)
clean["breathing: 5, 10, 15 mm"] = frame(BEADS)
clean["blood at 3, 10, 100 mm/s, mean of 8"] = flowing(0.0)
for name in ROWS:
    if name.startswith(("backlash", "motor", "frames")):
        clean[name] = across()
for name in ROWS:
    if name.startswith(("noise", "clutter", "gain errs", "agar")):
        clean[name] = frame(PLAIN, held(8), **BARE)
clean["kinds at 40 deg: coated, dimpled, spinal"] = frame(PLAIN, held(40))
for name in ("polished to 40, 20, 10 deg", "dimples at 16, 22, 28 dB"):
    clean[name] = frame(PLAIN, held(40))
figure, axes = plt.subplots(
    len(ROWS), 4, figsize=(11, 2.3 * len(ROWS)), facecolor=PAPER, layout="constrained"
)
for row, (name, shown) in zip(axes, ROWS.items(), strict=True):
    for panel, (grey, place) in zip(row, [clean[name], *shown], strict=True):
        panel.pcolormesh(
            *np.moveaxis(place[..., :2], -1, 0), grey, cmap="gray", vmin=0, vmax=255,
            shading="gouraud", rasterized=True,
        )  # fmt: skip
        panel.set(xlim=(-45, 45), ylim=(85, 0), aspect="equal", xticks=[], yticks=[])
        panel.set_facecolor(PAPER)
        panel.spines[:].set_visible(False)
    row[0].set_title("clean", color=INK, fontsize=8, loc="left")
    row[1].set_title(name, color=INK, fontsize=9, loc="left")
figure.savefig("gallery_of_dials.png", dpi=80, pil_kwargs={"optimize": True})
plt.close(figure)
print(f"written: {Path('gallery_of_dials.png').resolve()}")
