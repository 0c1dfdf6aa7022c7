r"""What is known of camera and conductor before looking, as the unknowns θ of the joint estimate and their prior.

Unknowns θ, all small corrections to the survey but sag, swing and load::

    0:3  turn of the camera, rad, camera frame        10:13  shift of attachment A, m
    3:6  shift of the camera, m, site frame           13:16  shift of attachment B, m
    6    relative change of the focal length          16     in-plane sag D, m
    7:9  shift of the principal point, px             17     swing φ, rad
    9    change of k1                                 18:28  terms of an uneven load
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from sagnode.geometry.camera import FloatArray, Intrinsics, Pose, turned
from sagnode.geometry.quantities import Shape

CAMERA = slice(0, 10)
ATTACHMENTS = slice(10, 16)
SAG, SWING = 16, 17
LOAD = slice(18, 28)
SIZE = 28


@dataclass(frozen=True)
class LoadPrior:
    """What is known of an uneven load before looking, as a Gaussian in its terms."""

    mean: FloatArray
    """Of the solved terms (10,), relative to the mean load."""
    covariance: FloatArray
    """Theirs (10, 10)."""
    finer: FloatArray
    """Second moments (K, K) of the terms beyond those, which are not solved for."""

    @cached_property
    def information(self) -> FloatArray:
        """Inverse of the covariance (10, 10)."""
        return np.asarray(np.linalg.inv(self.covariance))


@dataclass(frozen=True)
class Survey:
    """What is known of camera and conductor before looking; every ``_u`` is a standard uncertainty."""

    intrinsics: Intrinsics
    pose: Pose
    near: FloatArray
    far: FloatArray
    orientation_u: float
    """rad"""
    position_u: float
    focal_u_rel: float
    principal_point_u: float
    distortion_u: float
    attachment_u: float
    sag_range: tuple[float, float]
    swing_u: float
    """rad"""
    load_u: float = 0.0
    """Of each term of an uneven load, relative to the mean load; 0 takes the load for even."""
    load_prior: LoadPrior | None = None
    """What kind of load that is, where it is uneven; None where nothing is known but ``load_u``."""
    swing_mean: float = 0.0
    """Swing that is expected, rad: none, unless the other conductors of the span say so."""

    @cached_property
    def packed(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The surveyed camera, as compiled functions take it: lens, rotation (3, 3) and position (3,)."""
        rotation, position = (np.asarray(part, dtype=np.float64) for part in (self.pose.rotation, self.pose.position))
        return self.intrinsics.packed, rotation, position

    def prior_sigma(self) -> FloatArray:
        """Standard uncertainties of θ (28,); sag has a prior so wide that it says nothing within its range."""
        return self._sigma.copy()

    @cached_property
    def _sigma(self) -> FloatArray:
        sigma = np.empty(SIZE)
        sigma[0:3] = self.orientation_u
        sigma[3:6] = self.position_u
        sigma[6] = self.focal_u_rel
        sigma[7:9] = self.principal_point_u
        sigma[9] = self.distortion_u
        sigma[ATTACHMENTS] = self.attachment_u
        sigma[SAG] = 10 * (self.sag_range[1] - self.sag_range[0])
        sigma[SWING] = self.swing_u
        sigma[LOAD] = self.load_u if self.load_prior is None else np.sqrt(np.diag(self.load_prior.covariance))
        # what is stated as exactly known still needs a positive variance
        return np.maximum(sigma, 1e-9)

    def prior_mean(self) -> FloatArray:
        """θ₀ (28,): the survey itself, sag in the middle of its range, the expected swing, an even load."""
        mean = np.zeros(SIZE)
        mean[SAG] = 0.5 * (self.sag_range[0] + self.sag_range[1])
        mean[SWING] = self.swing_mean
        if self.load_prior is not None and self.load_u > 0:
            mean[LOAD] = self.load_prior.mean
        return mean

    def prior_information(self) -> FloatArray:
        """Inverse covariance (28, 28) of θ."""
        return self._information.copy()

    @cached_property
    def _information(self) -> FloatArray:
        information = np.diag(1 / self._sigma**2)
        if self.load_prior is not None and self.load_u > 0:
            information[LOAD, LOAD] = self.load_prior.information
        return information

    def unknowns(self) -> NDArray[np.intp]:
        """Which of θ are unknown at all: an even load has no terms."""
        return np.arange(SIZE if self.load_u > 0 else LOAD.start)

    def camera(self, theta: FloatArray) -> tuple[Intrinsics, Pose]:
        """Camera at θ."""
        base = self.intrinsics
        d = base.distortion
        if theta[9] and base.model == "pinhole":
            d = (d[0] + theta[9], *d[1:]) if d else (float(theta[9]), 0.0, 0.0, 0.0)
        scale = 1 + float(theta[6])
        # not dataclasses.replace, which takes longer than all the rest
        intrinsics = Intrinsics(
            width=base.width,
            height=base.height,
            fx=base.fx * scale,
            fy=base.fy * scale,
            cx=base.cx + float(theta[7]),
            cy=base.cy + float(theta[8]),
            distortion=d,
            model=base.model,
            reach=base.reach,
        )
        return intrinsics, turned(self.pose, theta[0:3], theta[3:6])

    def shape(self, theta: FloatArray) -> Shape:
        """Conductor at θ."""
        load = tuple(theta[LOAD]) if self.load_u > 0 else ()
        return Shape(self.near + theta[10:13], self.far + theta[13:16], float(theta[SAG]), float(theta[SWING]), load)
