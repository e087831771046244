"""A machine file out of drawings, a data sheet and logs of the machine at work."""
