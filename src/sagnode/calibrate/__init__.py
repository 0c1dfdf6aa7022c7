"""The camera's intrinsics: reading and writing their files, undistorting pictures, Zhang calibration."""

from sagnode.calibrate.undistort import undistort_image

__all__ = ["undistort_image"]
