"""Moving picture of the README: a run of fig. 5, drawn by Drake's renderer beside the slices.

Needs EGL, which Mesa provides without a graphics processor. Made by `make pictures`.
"""

from argparse import ArgumentParser
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from pydrake.geometry import (
    ClippingRange,
    ColorRenderCamera,
    MakeRenderEngineVtk,
    RenderCameraCore,
    RenderEngineVtkParams,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.sensors import CameraInfo

from sonoservo.diagrams import load_scenario, make_experiment
from sonoservo.systems.display.shapes import sector_edges
from sonoservo.systems.evaluation.reports.key_frames import true_needle
from sonoservo.systems.evaluation.run_errors import at_times, features
from sonoservo.systems.signals.needle_colours import ESTIMATE, TRUTH

PATH = Path(__file__).with_name("needle.webp")
WORLD, SLICE = (560, 500), (330, 246)
BEFORE, AFTER, RATE = 3.0, 11.0, 6.0  # s shown around the find of the needle; pictures a second
CAMERA, TARGET, FIELD_OF_VIEW = [1.05, -0.95, 0.62], [0.28, 0.0, 0.43], np.radians(42)
QUALITY = 60
BACKGROUND, INK, SECTOR = (245, 246, 248), (40, 44, 52), (90, 120, 170)


def look_at():
    """Return the pose of the camera: X right, Y down, Z forwards."""
    z = np.subtract(TARGET, CAMERA) / np.linalg.norm(np.subtract(TARGET, CAMERA))
    x = np.cross(z, [0, 0, 1]) / np.linalg.norm(np.cross(z, [0, 0, 1]))
    return RigidTransform(RotationMatrix(np.stack([x, np.cross(z, x), z], axis=1)), CAMERA)


X_WC = look_at()
CORE = RenderCameraCore(
    "vtk", CameraInfo(*WORLD, FIELD_OF_VIEW), ClippingRange(0.05, 5.0), RigidTransform()
)


def project(points):
    """Return the (m, 2) pixels of (m, 3) points in W."""
    p_C = X_WC.inverse().multiply(np.asarray(points, float).T).T.reshape(-1, 3)
    info = CORE.intrinsics()
    u = info.focal_x() * p_C[:, 0] / p_C[:, 2] + info.center_x()
    v = info.focal_y() * p_C[:, 1] / p_C[:, 2] + info.center_y()
    return list(zip(u.tolist(), v.tolist(), strict=True))


def render(experiment):
    """Return a picture of the world now."""
    query = experiment.evaluate(experiment.station, "query_object")
    world = query.inspector().world_frame_id()
    image = query.RenderColorImage(ColorRenderCamera(CORE, False), world, X_WC)
    return Image.fromarray(image.data[..., :3].copy())


def simulate():
    """Return the experiment after its run, and a picture of the world for each volume."""
    scenario = load_scenario("chatelain2013_fig5")
    experiment = make_experiment(scenario, pictures=True)
    parameters = RenderEngineVtkParams(
        backend="EGL", default_clear_color=np.array(BACKGROUND) / 255
    )
    scene_graph = experiment.station.GetSubsystemByName("scene_graph")
    scene_graph.AddRenderer("vtk", MakeRenderEngineVtk(parameters))
    worlds = {}

    def keep(each):
        if each.pictures:
            worlds[each.pictures[-1].time] = render(each)

    experiment.run(keep)
    return experiment, worlds


def draw_world(picture, log, volume, geometry):
    """Draw the swept sector and both needles over a picture of the world."""
    draw = ImageDraw.Draw(picture)
    X_WP = RigidTransform(log.volume_true_X_WP[volume])
    for edge in sector_edges(geometry):
        draw.line(project(X_WP.multiply(edge.T).T), fill=SECTOR, width=1)
    time = log.volume_time[[volume]]
    points = at_times(log, log.needle_points, time)[0]
    if np.isfinite(points).all():
        back = points[0] - points[-1]
        handle = points[0] + 0.09 * back / np.linalg.norm(back)
        draw.line(project([handle, points[0]]), fill=(120, 124, 132), width=2)
        draw.line(project(points), fill=TRUTH, width=3)
    tip = log.volume_estimate_tip[volume]
    if np.isfinite(tip).all():
        ends = project([log.volume_estimate_entry[volume], tip])
        draw.line(ends, fill=ESTIMATE, width=2)
        ring(draw, ends[1])


def ring(draw, centre, radius=7):
    """Draw a ring around the estimated tip."""
    x, y = centre
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), outline=ESTIMATE, width=2)


def draw_slice(plane, true):
    """Return a slice with both needles."""
    left, right, bottom, top = plane.extent
    scale = min(SLICE[0] / (right - left), SLICE[1] / (bottom - top))
    size = round(scale * (right - left)), round(scale * (bottom - top))
    grey = Image.fromarray(plane.grey).resize(size, Image.Resampling.BILINEAR)
    picture = Image.new("RGB", SLICE)
    at = (SLICE[0] - size[0]) // 2, (SLICE[1] - size[1]) // 2
    picture.paste(grey.convert("RGB"), at)
    draw = ImageDraw.Draw(picture)
    for points, colour in ((plane.project(true), TRUTH), (plane.needle, ESTIMATE)):
        line = [tuple(at + scale * (each - [left, top])) for each in points]
        if len(line):
            draw.line(line, fill=colour, width=1)
            if colour == ESTIMATE:
                ring(draw, line[-1], 6)
    return picture


def frames(experiment, worlds):
    """Yield the frames."""
    log, font = experiment.log(), ImageFont.load_default(size=18)
    errors = features(log.X_WP, log.needle_tip, log.needle_entry)
    found = log.volume_time[np.isfinite(log.volume_estimate_tip[:, 0])][0]
    for volume, time in enumerate(log.volume_time):
        if not -BEFORE <= time - found <= AFTER:
            continue
        taken = min(experiment.pictures, key=lambda each: abs(each.time - time))
        if taken.time not in worlds:
            continue
        frame = Image.new("RGB", (WORLD[0] + SLICE[0] + 6, WORLD[1] + 36), BACKGROUND)
        world = worlds[taken.time].copy()
        draw_world(world, log, volume, experiment.scanner.geometry)
        frame.paste(world, (0, 36))
        for row, plane in enumerate(taken.planes):
            picture = draw_slice(plane, true_needle(log, volume))
            frame.paste(picture, (WORLD[0] + 6, 36 + row * (SLICE[1] + 8)))
        x, z, theta = at_times(log, errors, np.array([time]))[0]
        text = f"{time:4.1f} s  {taken.mode}"
        if np.isfinite(x):
            text += (
                f"   X {1e3 * x:+.0f} mm   Z {1e3 * z:+.0f} mm   Theta {np.degrees(theta):+.0f} deg"
            )
        draw = ImageDraw.Draw(frame)
        draw.text((10, 8), text, font=font, fill=INK)
        draw.text((WORLD[0] + 16, 8), "true", font=font, fill=TRUTH)
        draw.text((WORLD[0] + 68, 8), "estimate", font=font, fill="#B87F00")
        yield frame


def main(path=PATH):
    """Write the moving picture."""
    first, *others = frames(*simulate())
    first.save(
        path, save_all=True, append_images=others, duration=round(1e3 / RATE), loop=0,
        quality=QUALITY, method=6,
    )  # fmt: skip
    print(f"written: {path}, {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("path", nargs="?", type=Path, default=PATH, help="file to write")
    main(parser.parse_args().path)
