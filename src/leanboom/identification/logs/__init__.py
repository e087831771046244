"""Logs of a machine: read, checked, and made ready for fits."""
