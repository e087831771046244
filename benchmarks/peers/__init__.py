"""Other ways to plan the same motions, measured side by side in one run: `python -m benchmarks.peers`."""
