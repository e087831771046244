"""Timing of a path: how fast it is followed, by the least time or the least energy."""
