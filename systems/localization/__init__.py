"""Where the needle is in one volume: candidates, RANSAC, tip; in one slice: its cross-section."""
