# %% [markdown]
# # In the browser, without installing anything here
#
# For Google Colab and other hosted notebooks: install the wheel, run, and see. Set `WHEEL` to the
# address of the wheel of a release; in a clone, where sonoservo is installed, nothing is fetched.
# No page needs to be opened.

# %%
import importlib.util
import os
import subprocess
import sys

WHEEL = os.environ.get("SONOSERVO_WHEEL", "")
if WHEEL and importlib.util.find_spec("sonoservo") is None:
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", WHEEL], check=True)

# %% [markdown]
# Sixteen seconds of fig. 5 of Chatelain, Krupa and Marchal (ICRA 2013): the probe presses, and a
# needle comes in and is found. The first run compiles the numeric kernels, about a minute.

# %%
# %matplotlib inline
from sonoservo.diagrams import run

changes = os.environ.get("SONOSERVO_QUICK", "duration=16").split()
result = run("chatelain2013_fig5", changes=changes, progress=False)
result

# %%
result.plots["run.png"][1]
