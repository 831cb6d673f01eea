"""Experiments (following a needle, predicting its shape), their scenarios and registry."""
