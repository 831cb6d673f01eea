# %% [markdown]
# # The loop in five minutes
#
# A robot presses a motorised 3D ultrasound probe on a phantom. A hand pushes a needle in, 40 deg
# across the image. The probe finds the needle, turns, and follows its tip: fig. 5 of Chatelain,
# Krupa and Marchal (ICRA 2013). Arm, contact, ultrasound and hand are simulated, so that the
# truth is known; tracker and controller never see it.

# %%
# %matplotlib inline
import os

import matplotlib.pyplot as plt
from rich.console import Console

from sonoservo.diagrams import load_scenario, make_experiment, run
from sonoservo.diagrams.app import summary_table
from sonoservo.systems.display.monitor import Monitor
from sonoservo.systems.evaluation import estimate_errors, plot_run

QUICK = ["duration=7", "hand.start=1", "hand.pushes.0.speed=0.016"]
scenario = load_scenario(
    "chatelain2013_fig5", changes=QUICK if "SONOSERVO_QUICK" in os.environ else []
)
print(scenario.description)
print(scenario.station.probe)
print(scenario.imaging)

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
    print(f"{', '.join(inputs) or '(none)':>60}  ->  {system.get_name()}  ->  {', '.join(outputs)}")

# %% [markdown]
# The scanner's monitor shows each volume as it comes: the two orthogonal planes through the
# estimated needle, in red, with a ring around the tip. Run the next two cells and look here. (In
# the terminal, `make run` shows the whole world besides.)

# %%
monitor = Monitor()
monitor

# %%
result = run(scenario, monitor=monitor)

# %% [markdown]
# The figures, beside the paper's. The paper could report only what it estimated; here the truth
# stands beside it.

# %%
Console(width=100).print(summary_table(result, scenario.published_figures))

# %% [markdown]
# Features that the servo drives to zero, tip, motion of the probe and force. Lines are the truth,
# dashes the estimate; grey is the time in which no needle was found yet.

# %%
plot_run(result.log, scenario.controller.force.force)

# %% [markdown]
# `result.log` holds every signal as an array, in SI units and in W (`systems/evaluation/README.md`
# lists them). How far is the estimate after each volume from the truth? Across the needle a few
# tenths of a millimetre, along it more: a beam 2 mm wide blurs the needle's end.

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
