"""Estimation: camera and conductor together, how sure the result is, and whether it may be told."""
