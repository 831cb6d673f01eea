# %% [markdown]
# # In Google Colab
#
# This notebook runs sonoservo in Colab and other hosted notebooks. In a clone,
# `pip wheel --no-deps .` makes the wheel. Upload it, and set `WHEEL` to its path or address.

# %%
import importlib.util
import os
import subprocess
import sys

WHEEL = ""
if importlib.util.find_spec("sonoservo") is None:
    if not WHEEL:
        raise SystemExit("Set WHEEL to the path or the address of the wheel first.")
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", WHEEL], check=True)

# %% [markdown]
# Fig. 5 of Chatelain, Krupa and Marchal (ICRA 2013): the probe presses, a needle comes in and is
# found, and the probe turns and follows it. The first run compiles the numeric kernels, about a
# minute.

# %%
# %matplotlib inline
from sonoservo.diagrams import run

changes = os.environ.get("SONOSERVO_QUICK", "duration=32").split()
result = run("chatelain2013_fig5", changes=changes, progress=False)
result

# %%
result.plot()
