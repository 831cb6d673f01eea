"""Data sets of simulated volumes with labels, for networks."""
