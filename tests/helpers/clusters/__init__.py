"""Cases for clusters, and the processes of a real one."""
