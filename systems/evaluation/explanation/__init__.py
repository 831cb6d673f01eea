"""Explanations of a tracker's decisions around a loss: recorded in a run, drawn afterwards."""
