"""The one door to every page of a run: a server that checks who asks, and Meshcat behind it."""
