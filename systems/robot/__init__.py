"""The simulated robot's own parts: wrist force sensor, the phantom's moving base, stepping stage."""
