"""A configuration held against what it speaks of: the lens, the reference picture, the geometry of the survey."""
