"""The simulated robot's own parts: wrist force sensor, moving base of the phantom, stepper."""
