"""Quantities at the borders of the package: units, and which values are allowed."""
