"""Fit of what a needle looks like in one volume: its volumes, its weights, and how good they are.

``PYTHONPATH=tests/helpers:tests/tools python -m looks_study`` makes the volumes, fits the weights
on the training ones, and prints them with their score on the others. Seeds from 1000 on are for
this; those below 1000 are for tests and reports. The images of `independent_images` are for judging
only and are not used.
"""
