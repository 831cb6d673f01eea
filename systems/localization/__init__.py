"""Where the needle is in one volume: candidates, RANSAC, tip."""
