# %% [markdown]
# # The loop in five minutes
#
# A robot presses a motorised 3D ultrasound probe on a phantom. A hand pushes a needle in at 40 deg
# to the image. The probe finds the needle, turns, and follows its tip, as in fig. 5 of Chatelain,
# Krupa and Marchal (ICRA 2013). Arm, contact, ultrasound and hand are simulated, so the ground
# truth is known; the tracker and the controller never see it.

# %%
# %matplotlib inline
import os
import textwrap

import matplotlib.pyplot as plt

from sonoservo.diagrams import load_scenario, make_experiment, run
from sonoservo.systems.display import Console
from sonoservo.systems.evaluation import estimate_errors

quick = os.environ.get("SONOSERVO_QUICK", "")  # what the tests change, to be done sooner
scenario = load_scenario("chatelain2013_fig5", changes=quick.split())
imaging = scenario.imaging
print(scenario.description)
print(f"The probe is turned by {scenario.station.probe.yaw_deg:.0f} deg.")
print(f"It sends {imaging.volume_rate} volumes a second, {1e3 * imaging.depth:.0f} mm deep.")

# %% [markdown]
# The experiment is a Drake diagram. Ports with the same name are connected. Frames: W world, P
# probe (X along the array, Y into the body, Z the sweep), T tissue. Lengths are in m.

# %%
for system in make_experiment(scenario).diagram.GetSystems():
    inputs, outputs = (
        [port(index).get_name() for index in range(count)]
        for port, count in (
            (system.get_input_port, system.num_input_ports()),
            (system.get_output_port, system.num_output_ports()),
        )
    )
    print(system.get_name())
    print(
        textwrap.fill(
            ", ".join(inputs) or "-", 80, initial_indent="   in  ", subsequent_indent=" " * 7
        )
    )
    print(
        textwrap.fill(
            ", ".join(outputs) or "-", 80, initial_indent="   out ", subsequent_indent=" " * 7
        )
    )

# %% [markdown]
# The console shows each volume as it is acquired: the two orthogonal planes through the estimated
# needle, with lines beside its echo and a ring around the tip. Run the next two cells and watch it
# here. In a terminal, `make run` also shows the whole world:
#
# ![The console](console.png)

# %% tags=["remove-output"]
console = Console()
console

# %%
result = run(scenario, console=console)

# %% [markdown]
# The figures of the run beside the paper's. The paper could only report estimated errors; here they
# can be compared with ground truth.

# %%
result

# %% [markdown]
# The plots show the features that the servo drives to zero, the tip, the motion of the probe and
# the force. In the top two panels, solid lines are the truth and dashed lines the estimate. Grey
# marks the time before a needle was found.

# %%
result.plot()

# %% [markdown]
# `result.log` holds every signal as an array, in SI units and in W (see the list in
# `systems/evaluation/README.md`). Across the needle, the estimate is off by a tenth or two of a
# millimetre. Along it, the error is larger, because a beam 2 mm wide blurs the needle's end.

# %%
log, errors = result.log, estimate_errors(result.log)
plt.figure(figsize=(9, 3))
plt.plot(log.volume_time, 1e3 * errors.axial, ".-", label="along the needle, beyond the tip")
plt.plot(log.volume_time, 1e3 * errors.lateral, ".-", label="across it")
plt.axhline(0, color="0.6", linewidth=1)
plt.xlabel("time of the volume (s)")
plt.ylabel("error of the tip (mm)")
plt.legend()
plt.show()
