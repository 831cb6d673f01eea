# %% [markdown]
# # Predicting a needle's shape
#
# A bevelled needle bends as it is inserted. Carriere, Rossa, Usmani, Sloboda and Tavakoli (AIM
# 2016) find its cross-section in axial slices, and predict its final shape from the first of them.
# Here, the probe steps along the needle, the bevel is turned at a depth of 60 mm, and only the
# slices up to that depth are used.

# %%
# %matplotlib inline
import os

import matplotlib.pyplot as plt
import numpy as np

from sonoservo.diagrams import load_scenario, run
from sonoservo.systems.evaluation import plot_shape

COARSE = ["step=0.004"] if "SONOSERVO_QUICK" in os.environ else []

# %% [markdown]
# There are three estimators: a particle filter on the bicycle model's radius, first angle and
# plane, with a curvature that may wander along the path; Bayesian least squares with a constant
# curvature; and the particle filter as published.

# %%
results = {
    estimator: run(load_scenario("carriere2016_d60", changes=[f"estimator={estimator}", *COARSE]))
    for estimator in ("particle_filter", "least_squares", "published")
}

# %% [markdown]
# The path over depth, in the needle's plane of bending (top) and across it. The bevel is turned at
# the dashed line. Left of it, the slices were used; right of it, the needle is predicted. The band
# contains it with a probability of 95 % if the curvature wanders as much as the estimator assumes,
# by about 10 %.

# %%
result = results["particle_filter"]
shape = result.results["shape"]
plot_shape(result.log, shape)

# %% [markdown]
# `shape` is a weighted set of paths. It returns positions in W and their uncertainty at any depth.

# %%
depths = np.linspace(0, 0.14, 8)
for depth, position, deviation in zip(
    depths, shape.positions(depths), shape.std(depths), strict=True
):
    x, y, z = 1e3 * position
    print(f"{1e3 * depth:4.0f} mm: {x:6.2f} {y:6.2f} {z:6.2f} mm, +- {1e3 * deviation:.2f} mm")

# %% [markdown]
# The error of the predicted tip against ground truth as the slices arrive, for each estimator:

# %%
plt.figure(figsize=(9, 3.5))
for name, each in results.items():
    miss = np.linalg.norm(each.log.tip - each.log.true[-1, :2], axis=1)
    plt.semilogy(1e3 * each.log.depth, 1e3 * miss, label=name)
plt.xlabel("depth of the newest slice (mm)")
plt.ylabel("error of the predicted tip (mm)")
plt.legend()
plt.show()
# %%
for name, each in results.items():
    miss = 1e3 * np.linalg.norm(each.log.tip[-1] - each.log.true[-1, :2])
    figures = each.summary["prediction"]
    print(
        f"{name:>16}: tip {miss:.2f} mm off, "
        f"stated deviation {figures['tip_std_mm']:.2f} mm, "
        f"area between the paths {figures['shape_error_true_mm2']:.1f} mm²"
    )

# %% [markdown]
# A single needle proves nothing. `sonoservo reproduce carriere2016` compares the estimators over
# hundreds.
