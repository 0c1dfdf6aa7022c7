"""sagnode: sag and ground clearance of power-line conductors from one camera on the tower."""

__version__ = "0.1.0"
