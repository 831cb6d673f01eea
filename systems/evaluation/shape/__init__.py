"""Logs, errors and plots of predicted needle shapes."""
