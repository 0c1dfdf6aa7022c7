"""The compiled functions. Arrays may have gaps where nothing else is said; results are written into those at the end.

A wrong kind or number of axes raises TypeError, shapes that do not fit each other ValueError.
"""

from typing import Any, TypeAlias

from numpy.typing import NDArray

Array: TypeAlias = NDArray[Any]

INTERFACE: int

def places(
    chord: Array,
    slope: Array,
    bend: Array,
    turn: Array,
    lens: Array,
    sag: Array,
    cosine: Array,
    sine: Array,
    first: int,
    width: float,
    step: Array,
    u: Array,
    v: Array,
    nu: Array,
    nv: Array,
    side: Array,
) -> None:
    """:meth:`sagnode.match.family.Family.placed`: samples from ``first`` on into u, v, nu and nv (n, K).

    And into side: of a wire of ``width`` (px at one metre of depth) the distance of its sides as
    :func:`sagnode.match.library.places_of` has them, whole numbers of the steps (n,) where these are not zero; the
    samples' depths if the width is zero. All single precision, without gaps, but lens (17,), which is
    :attr:`sagnode.geometry.camera.Intrinsics.packed`. chord (N, 3), slope and bend (N,), turn (3, 3), sag, cosine and
    sine (K,).
    """

def response(
    image: Array,
    u: Array,
    v: Array,
    nu: Array,
    nv: Array,
    places: Array,
    sides: Array,
    band: Array,
    best: Array,
    seen: Array,
) -> None:
    """:func:`sagnode.match.ribbon.pooled_response` into best (M, N) int16 and seen (M, N) bool.

    image uint8; u, v, nu, nv (M, N), places and sides (m, M or 1, N or 1), m up to 16, and band (B, M or 1) are single
    precision.
    """

def response_sums(
    image: Array,
    u: Array,
    v: Array,
    nu: Array,
    nv: Array,
    places: Array,
    sides: Array,
    band: Array,
    weight: Array,
    total: Array,
    weights: Array,
) -> None:
    """Sums over the samples in the frame of their weight (M,) times response, and of weight: (N,), double precision."""

def localise(
    image: Array,
    pixels: Array,
    normal: Array,
    width: Array,
    half_range: Array,
    members: Array,
    starts: Array,
    centres: Array,
    blur_px: float,
    margin_px: float,
    exact: bool,
    blocks: Array,
    valid: Array,
    beside: Array,
    inside: Array,
) -> None:
    """:func:`sagnode.match.across.look_across`: M blocks at ``starts``, S + 1 places at ``centres``, 0 the first.

    image uint8 or single precision; pixels and normal (N, 2), width and half_range (N,), members (m, N), m up to 64,
    are double precision, starts (M,) and centres (S + 1,) int64 without gaps. Results: blocks (16, M) of which the
    first five are offset, sigma, snr, correlation and contrast, valid (M,) bool, beside (S, M) the snr at the other
    places, inside (S, M) bool.
    """

def shared_products(
    kept: Array, sigma: Array, white: Array, rows: Array, grid: Array, products: Array, spread: Array
) -> None:
    """Products of rows (M, K) whitened by every size of a shared error: :mod:`sagnode.estimate.whitened`.

    grid (G, 2) has the sizes; the results go into products (G, K, K) and spread (G,), logarithms of determinants. kept,
    sigma and white are (M,); all are of double precision and contiguous.
    """

def solve_each(matrices: Array, right: Array, solution: Array, spread: Array) -> None:
    """:func:`sagnode.estimate.steps.solved_each`: of matrices (K, n, n) and right (K, n, r), double and contiguous.

    The results go into solution (K, n, r) and spread (K,), logarithms of determinants.
    """

def sum_explanations(level: Array, swing: Array, variance: Array, common: Array, spread: Array, out: Array) -> None:
    """Logarithm (N,) of the sum of explanations (K,) at some common swings (N,): :mod:`sagnode.estimate.swings`.

    spread (N,) is the variance of swings about each of them; all are of double precision and contiguous.
    """

def near_polyline(pixels: Array, normal: Array, reach: Array, other: Array, masked: Array) -> None:
    """:func:`sagnode.match.masks.near`, added to masked (M,) bool.

    pixels, normal (M, 2), reach (M,) and other (K, 2) are double precision.
    """

def folds_back(pixels: Array, normal: Array, arc: Array, index: Array, reach: Array, every: int, masked: Array) -> None:
    """:func:`sagnode.match.masks.folds_back`, added to masked (M,) bool.

    pixels, normal (N, 2), arc (N,) and reach (M,) are double precision, index (M,) int64; every so many samples of the
    curve are compared.
    """

def stand_out(
    offset: Array,
    sigma: Array,
    snr: Array,
    arc: Array,
    valid: Array,
    beside: Array,
    inside: Array,
    masked: Array,
    half_range: Array,
    widest: float,
    run: int,
    rank: Array,
    place: Array,
    uncertainty: Array,
    usable: Array,
) -> None:
    """:func:`sagnode.match.standing.stand_out` into rank, place, uncertainty (M,) and usable (M,) bool.

    offset, sigma, snr, arc, half_range (M,) and beside (S, M), S at least 2, are double precision, valid, masked (M,)
    and inside (S, M) bool, all without gaps.
    """

def sight(response: Array, t: Array, arc: Array, seen: Array) -> tuple[float, int, int]:
    """:func:`sagnode.match.sight.compared`: score, windows judged and outstanding; samples into seen (N,) bool.

    response (K, N), K up to 256, is single precision, t and arc (N,) are double precision, all without gaps.
    """

# What is measured below is double precision. A camera is told by sagnode.geometry.camera.Intrinsics.packed (17,), the
# rotation (3, 3) and position (3,) of its pose; a conductor by near (3,), far (3,), sag, swing and load (K,).

def curve_pixels(
    lens: Array,
    rotation: Array,
    position: Array,
    near: Array,
    far: Array,
    sag: float,
    swing: float,
    load: Array,
    t: Array,
    pixels: Array,
    depth: Array,
) -> None:
    """:meth:`sagnode.match.templates.View.pixels` at t (N,) into pixels (N, 2) and depth (N,)."""

def curve_points(near: Array, far: Array, sag: float, swing: float, load: Array, t: Array, points: Array) -> None:
    """:func:`sagnode.geometry.conductor.conductor_points` of one conductor at t (N,) into points (N, 3)."""

def project(lens: Array, rotation: Array, position: Array, points: Array, pixels: Array, depth: Array) -> None:
    """:func:`sagnode.geometry.camera.project` of points (N, 3) without gaps into pixels (N, 2) and depth (N,)."""

def curve_visible(
    lens: Array,
    rotation: Array,
    position: Array,
    near: Array,
    far: Array,
    sag: float,
    swing: float,
    load: Array,
    margin: float,
    nodes: float,
    nearest: float,
    arc: Array,
    t: Array,
) -> int:
    """:func:`sagnode.match.templates.visible_part` into the beginning of arc and t (4 * nodes,); how many there are.

    nodes and nearest are NODES and NEAREST_SHARE there.
    """

def curve_track(
    lens: Array,
    rotation: Array,
    position: Array,
    near: Array,
    far: Array,
    sag: float,
    swing: float,
    load: Array,
    arc: Array,
    at: Array,
    t: Array,
    pixels: Array,
    depth: Array,
    normal: Array,
    along: Array,
) -> int:
    """Samples evenly along a visible part, arc and at (K,) as ``curve_visible`` gives them; how many the camera sees.

    They begin t, depth and along, the length there (N,), pixels and normal (N, 2): what
    :func:`sagnode.match.track.trace` makes of them.
    """

def curve_terms(
    lens: Array,
    rotation: Array,
    position: Array,
    near: Array,
    far: Array,
    theta: Array,
    t: Array,
    normal: Array,
    measured: Array,
    free: int,
    residual: Array,
    jacobian: Array,
) -> None:
    """:func:`sagnode.estimate.offsets.curve_terms` into residual (M,) and jacobian (M, 28).

    Camera and conductor are those of the survey; theta (28,), t, normal and measured are without gaps; free is how many
    of theta are unknown, 18 or 28.
    """

def solve_camera(
    lens: Array,
    rotation: Array,
    position: Array,
    theta: Array,
    sigma: Array,
    positions: Array,
    position_u: Array,
    pixels: Array,
    pixel_u: Array,
    settings: Array,
    iterations: int,
    precision: Array,
    vector: Array,
    residual: Array,
    weight: Array,
) -> float:
    """:func:`sagnode.estimate.camera.solve_camera` from theta (28,), which it moves; z.

    sigma (10,) is the prior's; positions (N, 3) and pixels (N, 2) with their uncertainties (N,) are the landmarks;
    settings are what residual counts half and what step is the last. Results go into theta, precision (10, 10), vector
    (10,), residual (N, 2) and weight (N,).
    """

def solve(
    lens: Array,
    rotation: Array,
    position: Array,
    near: Array,
    far: Array,
    theta: Array,
    t: Array,
    normal: Array,
    measured: Array,
    free: int,
    arc: Array,
    sigma: Array,
    shading: Array,
    known: Array,
    target: Array,
    longest: Array,
    settings: Array,
    iterations: int,
    covariance: Array,
    residual: Array,
    weight: Array,
    noise: Array,
    jacobian: Array,
) -> tuple[float, float, int]:
    """:func:`sagnode.estimate.joint.solve` from theta, which it moves; inflation, misfit, and whether it converged.

    arc rises; shading (M, at most 2) is what lights move offsets by; known (28, 28), target (28,) and longest (free,)
    are the prior and the longest steps there; settings are its constants, and bounds of sag and swing. A step that
    leads nowhere is not taken. Results go into theta, covariance (28, 28), residual, weight, noise (M,) and jacobian
    (M, 28).
    """

# Several shapes at once: near and far (S, 3), sag and swing (S,), load (S or 1, K); t (N,) without gaps; the ground's
# along and height (G,) and obstacles (M, 3).

def quantities(
    near: Array,
    far: Array,
    sag: Array,
    swing: Array,
    load: Array,
    t: Array,
    along: Array,
    height: Array,
    obstacles: Array,
    result: Array,
) -> None:
    """What :func:`sagnode.geometry.quantities.quantities_of_many` looks for along the curves, into result (10, S).

    Rows: sag, in-plane sag, blow-out, least height and its place, least clearance and its place, height at mid-span and
    clearance there, constant of the catenary.
    """

def clearance_place_u(
    near: Array,
    far: Array,
    sag: Array,
    swing: Array,
    load: Array,
    t: Array,
    along: Array,
    height: Array,
    obstacles: Array,
    height_u: float,
) -> float:
    """:func:`sagnode.geometry.quantities.clearance_place_u` of one shape."""
