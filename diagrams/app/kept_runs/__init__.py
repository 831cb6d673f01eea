"""Folders of runs: written, compared and explained."""
