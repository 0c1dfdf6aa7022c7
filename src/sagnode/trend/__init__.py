"""What a conductor's sag can do between two readings, and which readings contradict it.

A reading that no heating, cooling or swinging explains is marked; no number is ever changed, smoothed or held back.
Pure arithmetic on frozen dataclasses: no NumPy, no clock, no file. The daemon is its caller.
"""
