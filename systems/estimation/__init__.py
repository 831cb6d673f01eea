"""Where the needle is, given all volumes so far; its shape, given all slices."""
