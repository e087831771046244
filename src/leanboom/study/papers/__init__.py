"""The two papers' experiments: machines varied, methods run, values beside the printed ones."""
