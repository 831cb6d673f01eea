"""Errors of the probe's measured pose: calibration of arm and probe, and delay."""
