"""From a pixel to metres with a known depth, and from heights to sag and clearance (sections 3.4 and 3.5)."""

from __future__ import annotations

import numpy as np

from sagnode.geometry.camera import FloatArray, Intrinsics, Pose


def pixel_to_world(intrinsics: Intrinsics, pose: Pose, pixel: FloatArray, depth: float) -> FloatArray:
    """Site coordinates (3,) of an undistorted pixel (2,) at ``depth`` m along the optical axis (section 3.4.1).

    ``X = Zc R⁻¹ K⁻¹ (u, v, 1)ᵀ - R⁻¹ t``, where ``-R⁻¹ t`` is the centre of projection.
    """
    ray = np.array([(pixel[0] - intrinsics.cx) / intrinsics.fx, (pixel[1] - intrinsics.cy) / intrinsics.fy, 1.0])
    return np.asarray(depth * pose.rotation.T @ ray + pose.position)


def frontal_offset(intrinsics: Intrinsics, pixel: FloatArray, d_cam: float) -> FloatArray:
    """(X, Y) m, to the right of and below the optical axis: section 3.4.3, axis level and perpendicular to the span."""
    x = d_cam * (pixel[0] - intrinsics.cx) / intrinsics.fx
    y = d_cam * (pixel[1] - intrinsics.cy) / intrinsics.fy
    return np.array([x, y])


def sag_from_height(h_tower: float, lowest_height: float) -> float:
    """Sag, m: section 3.4.3's ``h_tower - Y_sag - h_camera``, ``Y_sag + h_camera`` being the lowest point's height."""
    return h_tower - lowest_height


def distance_to_ground(support_height: float, sag: float) -> float:
    """Clearance, m: section 3.5's "distance to ground = support height - sag", support height above the ground."""
    return support_height - sag


def midspan_depth(pose: Pose, near: FloatArray, far: FloatArray, sag: float) -> float:
    """d_cam, m: depth along the optical axis of mid-span, ``sag`` below the middle of the chord (section 3.4.2)."""
    middle = 0.5 * (near + far) - np.array([0.0, 0.0, sag])
    return float(pose.rotation[2] @ (middle - pose.position))


def fictive_line_height(
    intrinsics: Intrinsics, pose: Pose, foot: FloatArray, curve: FloatArray
) -> tuple[FloatArray, float] | None:
    """Where the projected vertical line through ``foot`` (3,) cuts a curve (N, 2): pixel (2,) and height, m.

    Section 4.2: "vertical reference lines were drawn at mid-span"; the height is the site height of the point of that
    line which the pixel shows. None where the line does not cut the curve, or lies behind the camera.
    """
    # homogeneous pixel of the point at height z on the line: origin + z * up
    projection = intrinsics.matrix @ pose.rotation
    origin = projection @ (np.array([foot[0], foot[1], 0.0]) - pose.position)
    up = projection @ np.array([0.0, 0.0, 1.0])
    line = np.cross(origin, up)
    size = float(np.hypot(line[0], line[1]))
    if size < 1e-12 or origin[2] + foot[2] * up[2] <= 0:
        return None
    side = (curve @ line[:2] + line[2]) / size
    crossings = np.flatnonzero((side[:-1] <= 0) != (side[1:] <= 0))
    if not len(crossings):
        return None
    # a curve may cut the line twice; the cut nearest to the known mid-span height is meant
    best: tuple[FloatArray, float] | None = None
    for i in crossings:
        share = side[i] / (side[i] - side[i + 1])
        pixel = curve[i] + share * (curve[i + 1] - curve[i])
        # the coordinate in which the line moves most gives the height
        k = int(np.argmax(np.abs(up[:2] * origin[2] - origin[:2] * up[2])))
        height = float((pixel[k] * origin[2] - origin[k]) / (up[k] - pixel[k] * up[2]))
        if best is None or abs(height - foot[2]) < abs(best[1] - foot[2]):
            best = np.asarray(pixel), height
    return best
