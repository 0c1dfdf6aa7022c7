"""Matching: how well a curve lies on a wire, where the wire is across the curve, and which curve fits best."""
