"""Capture: frames from files, V4L2 devices and Raspberry Pi cameras, behind one small port."""
