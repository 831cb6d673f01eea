"""The benchmark of needle trackers: sequences of volumes, scores and their report."""
