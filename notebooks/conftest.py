"""The tests run the notebooks in their short form."""

import os

os.environ["SONOSERVO_QUICK"] = "1"
