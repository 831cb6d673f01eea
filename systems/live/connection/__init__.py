"""Sockets and messages of live connections.

A link keeps up one connection, or serves any number of peers; `open_igt_link` turns bytes into
items and back. This room imports `files` and `signals`.
"""
