"""Displays of a running simulation.

The room `console` is the page on which a run is watched and controlled; the room `world` draws the
3D view in it with Drake's Meshcat. Colours, shapes and textured quads serve both.
"""
