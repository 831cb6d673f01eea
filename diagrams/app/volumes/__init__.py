"""Recorded volumes: track, locate and reconstruct."""
