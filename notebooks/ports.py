"""Picture of the blocks' ports, read from the blocks themselves, by `make pictures`."""

from argparse import ArgumentParser
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.patches import Rectangle

from sonoservo.diagrams import MakeNeedleTracker, MakeProbeController, ProbeControllerParameters

HERE = Path(__file__).parent
OPTIONAL = {"gain", "force_target", "confirmation", "external_torque"}
ROW, WIDTH = 0.3, 2.6


def ports(system):
    """Names of a system's inputs and outputs."""
    return (
        [system.get_input_port(n).get_name() for n in range(system.num_input_ports())],
        [system.get_output_port(n).get_name() for n in range(system.num_output_ports())],
    )


tracker = MakeNeedleTracker(period=1.0)
controller = MakeProbeController(parameters=ProbeControllerParameters())
BLOCKS = {
    "your scanner": (0.0, ([], ["volume"]), "white"),
    "MakeNeedleTracker": (3.9, ports(tracker), "#e4eefb"),
    "MakeProbeController": (7.8, ports(controller), "#e4eefb"),
    "your robot": (
        11.7,
        (["joint_command"], ["X_WP", "wrist_force", "joint_state", "external_torque"]),
        "white",
    ),
}


def draw() -> None:
    """Draw the blocks from left to right, and a line between ports of one name."""
    figure, axes = plt.subplots(figsize=(12, 3.2), layout="constrained")
    places, returned = {}, 0
    for name, (x, (inputs, outputs), colour) in BLOCKS.items():
        height = ROW * (max(len(inputs), len(outputs)) + 0.6)
        axes.add_patch(Rectangle((x, -height), WIDTH, height, facecolor=colour, edgecolor="0.3"))
        axes.text(x + WIDTH / 2, 0.12, name, ha="center", weight="bold", fontsize=10)
        for side, names in (("in", inputs), ("out", outputs)):
            for row, port in enumerate(names):
                at = x + (0 if side == "in" else WIDTH), -ROW * (row + 0.8)
                places[name, side, port] = at
                axes.plot(*at, "o", color="0.3", markersize=4)
                align = {"ha": "left" if side == "in" else "right", "va": "center"}
                shift = 0.1 if side == "in" else -0.1
                grey = "0.55" if port in OPTIONAL else "black"
                axes.text(at[0] + shift, at[1], port, fontsize=8, color=grey, **align)
    for (source, side, port), start in places.items():
        for (target, other, wanted), end in places.items():
            if side == "out" and other == "in" and port == wanted and source != target:
                dashed = "dashed" if port in OPTIONAL else "solid"
                points = [start, end]
                if end[0] < start[0]:  # back below the blocks, each on a lane of its own
                    returned += 1
                    lane = 0.15 * returned
                    right, left, low = start[0] + 0.15 + lane, end[0] - lane, -2.6 - lane
                    points = [start, (right, start[1]), (right, low), (left, low), (left, end[1])]
                    points.append(end)
                axes.plot(*zip(*points, strict=True), color="#1d6fa5", linestyle=dashed, zorder=0)
    axes.set(xlim=(-0.2, 15.3), ylim=(-3.4, 0.5))
    axes.axis("off")
    figure.savefig(HERE / "ports.png", dpi=110)


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    draw()
