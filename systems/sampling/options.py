"""Options of the compiled kernels."""

OPTIONS = {"cache": True, "fastmath": True, "error_model": "numpy", "nogil": True}
"""Options of every kernel: fast arithmetic without checks, cached, and without the GIL."""
