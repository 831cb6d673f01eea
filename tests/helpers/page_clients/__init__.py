"""Clients of our pages: a browser, and sockets that speak as one."""
