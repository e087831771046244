"""Studies: methods compared, and the papers' experiments reproduced."""
