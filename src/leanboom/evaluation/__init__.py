"""The judge: any motion measured every 2 ms against energy, limits and path, whatever method made it."""
