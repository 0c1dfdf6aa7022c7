"""The daemon process: schedule, record, publish, show. It imports neither NumPy nor OpenCV."""
