"""Where the needle is, given all volumes so far."""
