"""Configuration: one file for the node, one for the span it watches (the survey)."""
