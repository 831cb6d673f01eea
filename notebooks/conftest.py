"""Settings of the tests, which run the notebooks in a short form."""

import os

os.environ["SONOSERVO_QUICK"] = "1"
