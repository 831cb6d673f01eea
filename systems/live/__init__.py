"""Volumes, poses and estimates over sockets, to and from other programs."""
