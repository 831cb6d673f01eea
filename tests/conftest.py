"""Settings that must be there before NumPy is imported."""

import os

# Small matrix products are ten times as fast with one thread, which PyMUST's are by the thousand.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
