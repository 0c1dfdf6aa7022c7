"""Geometry: cameras, conductors and ground as pure functions over arrays and frozen dataclasses."""
