# %% [markdown]
# # In your own diagram
#
# Every block is a Drake system. This notebook connects the tracker and the visual servo to your
# scanner and your robot in a diagram of your own. These are the ports of the whole loop (grey:
# optional). The visual servo is a part of the controller.
#
# ![Ports of scanner, tracker, controller and robot](ports.png)

# %%
# %matplotlib inline
import os
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
from pydrake.common.value import Value
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import ConstantValueSource, LogVectorOutput

from sonoservo.diagrams import MakeNeedleTracker, load_scenario, run
from sonoservo.systems.control import VisualServo, VisualServoParameters
from sonoservo.systems.recording import Recording

# %% [markdown]
# A recording stands in for your scanner: a needle that is pushed in while the probe rests.

# %%
changes = os.environ.get("SONOSERVO_QUICK", "duration=20 hand.pushes.0.speed=0.005").split()
folder = tempfile.TemporaryDirectory()
path = Path(folder.name) / "mine.seq.nrrd"
run(load_scenario("chatelain2013_fig4", changes=changes), record=path)
volumes = list(Recording(path))
print(len(volumes), "volumes of", volumes[0].intensities.shape)

# %% [markdown]
# Your scanner is a system with the output `volume`, which carries a `Volume`: grey levels on a grid
# in the probe frame P, and the pose `X_WP` at its `time`. Your robot supplies that pose and
# receives the velocity that the servo commands, in the X-Z plane of P and about its Y axis.


# %%
class MyScanner(LeafSystem):
    """Hands out one volume after another; replace it with your scanner's driver."""

    def __init__(self, volumes):
        super().__init__()
        self._volumes = volumes
        self.DeclareAbstractOutputPort("volume", lambda: Value[object](), self._calc_volume)

    def _calc_volume(self, context, output):
        seen = [each for each in self._volumes if each.time <= context.get_time()]
        output.set_value(seen[-1] if seen else self._volumes[0])


PERIOD = volumes[1].time - volumes[0].time
builder = DiagramBuilder()
scanner = builder.AddNamedSystem("my_scanner", MyScanner(volumes))
robot = builder.AddNamedSystem("my_robot", ConstantValueSource(Value(volumes[0].X_WP)))
tracker = builder.AddNamedSystem("needle_tracker", MakeNeedleTracker(period=PERIOD))
servo = builder.AddNamedSystem("visual_servo", VisualServo(parameters=VisualServoParameters()))
builder.Connect(scanner.GetOutputPort("volume"), tracker.GetInputPort("volume"))
builder.Connect(tracker.GetOutputPort("estimate"), servo.GetInputPort("estimate"))
builder.Connect(robot.get_output_port(), servo.GetInputPort("X_WP"))
log = LogVectorOutput(servo.GetOutputPort("planar_velocity"), builder, PERIOD / 4)
diagram = builder.Build()

# %%
simulator = Simulator(diagram)
simulator.AdvanceTo(volumes[-1].time + PERIOD)
context = tracker.GetMyContextFromRoot(simulator.get_context())
estimate = tracker.GetOutputPort("estimate").Eval(context)
print(
    f"{estimate.mode} at {estimate.time:.1f} s; tip in W, m:",
    estimate.curve and estimate.curve.tip.round(4),
)

# %% [markdown]
# The servo commands nothing until the needle is found. This robot does not move, so the commanded
# velocity along X grows with the tip's distance, up to the limit of 30 mm/s.

# %%
LABELS = ("along X (mm/s)", "along Z (mm/s)", "about Y (0.001 rad/s)")
wanted = log.FindLog(simulator.get_context())
plt.figure(figsize=(9, 3))
for row, label in zip(wanted.data(), LABELS, strict=True):
    plt.plot(wanted.sample_times(), 1e3 * row, label=label)
plt.xlabel("time (s)")
plt.legend()
plt.show()

# %% [markdown]
# To close the loop, connect `MakeProbeController(parameters=ProbeControllerParameters())` of
# `sonoservo.diagrams` in place of the servo. It adds the force law, the arm's kinematics and the
# guard. Its `joint_command` goes to your arm.
