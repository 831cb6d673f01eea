"""What is written to files: log, plots, replay."""
