"""Settings that must be there before NumPy is imported."""

import os

# Small matrix products are ten times as fast with one thread, which PyMUST's are by the thousand.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from hypothesis import settings

# The first example may have to wait for a kernel to be compiled.
settings.register_profile("compiled", deadline=None)
settings.load_profile("compiled")
