"""The uncalibrated fit: one conductor between two points of any photograph, with nothing known of camera or span."""
