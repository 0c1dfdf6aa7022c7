"""The worker process: it owns the camera and the mathematics, and may be killed at any moment."""
