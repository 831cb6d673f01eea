"""Options of the compiled kernels."""

OPTIONS = {"cache": True, "fastmath": True, "error_model": "numpy", "nogil": True}
"""Of every kernel: single precision where it lets more run at a time, and no checks."""
