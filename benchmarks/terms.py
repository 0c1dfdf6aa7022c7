"""What stands between the estimate and the least-squares limit of a frame; by group.

    python benchmarks/terms.py [--groups tower,field,lab45,side100] [--worlds 6] [--seed 1] [--out docs]

The limit (`benchmarks/limit.py`) takes the clicks for exact but for their click, the whole visible wire as seen, and no
noise but the sensor's. Here its parts are replaced one by one by what the node had of the very same frame: its tracked
landmarks; the blocks that it measured, as uncertain as each looks before its background; what neighbouring blocks
share (which makes it what the node states). Medians over the conductors that it took for evenly loaded.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from limit import across, information_per_pixel, landmark_information, true_theta
from looks import Look, looks
from run import DEVELOPMENT_SEED
from sagnode.estimate.matched import Matched
from sagnode.geometry.camera import FloatArray
from sagnode.scene.render import Rendered
from sagnode.scene.spec import Moment
from sagnode.survey import CAMERA, SAG

ROOT = Path(__file__).resolve().parents[1]
COLUMNS = (
    "limit",
    "with its landmarks",
    "and its blocks",
    "and what they share",
    "and the others' curves",
    "blocks reach over",
)
WORDS = """\
The least-squares limit of a frame takes every clicked landmark to be found again exactly, every pixel of the visible
wire to be measured, and the sensor's noise for the only noise. What the node had of the very same frames takes the
place of these one by one. All are standard uncertainties of sag in the swung plane, medians over evenly loaded
conductors.

- **limit**: as `docs/accuracy.md` uses it.
- **with its landmarks**: as they were tracked.
- **and its blocks**: the stretches of wire that were measured, each as uncertain as it looks before its background.
  What is lost here is lost to what stands behind the wire: texture, edges, other wires, which are no noise of the
  sensor.
- **and what they share**: errors that neighbouring blocks have in common. This is what the node states.
- **and the others' curves**: were the camera also held by what the span's other conductors say of it, as it would be in
  one estimate for all (decision 2 says why there is none).
- **blocks reach over**: share of the span between the first and the last block."""


def terms(look: Look, name: str, found: Matched, of_others: FloatArray) -> list[float] | None:
    """Standard uncertainties of sag, m, with more and more of what the node had; None without a wire in the frame.

    ``of_others`` (10, 10) is what the other conductors say of the camera.
    """
    true = next(c for c in look.shot.scene.true.conductors if c.id == name)
    survey, solution = found.survey, found.solution
    theta = true_theta(survey, look.shot.scene, look.shot.moment, true)
    landmarks = landmark_information(look.site, survey, theta)
    whole = _summed(_wires(found, theta, look.picture, name, look.shot.moment))
    if whole is None:
        return None
    jacobian = solution.jacobian
    blocks = jacobian.T @ (jacobian / solution.white[:, None])
    shared = _of_curve(found)
    own = look.registered.camera.precision
    steps = [(landmarks, whole), (own, whole), (own, blocks), (own, shared), (own + of_others, shared)]
    reach = float(np.ptp(found.offsets.t))
    return [*(_sag_u(found, camera, curve) for camera, curve in steps), reach]


def _wires(
    found: Matched, theta: FloatArray, picture: Rendered, name: str, moment: Moment
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Derivatives (N, 28) and information (N,) of every pixel of the length of each visible wire."""
    for wire in picture.seen.get(name, ()):
        if wire.place.size >= 2:
            jacobian = across(found.survey, theta, wire.place)
            kept = np.isfinite(jacobian).all(axis=1)
            yield jacobian[kept], information_per_pixel(wire, moment)[kept]


def _summed(parts: Iterator[tuple[FloatArray, FloatArray]]) -> FloatArray | None:
    pieces = [(jacobian * weight[:, None]).T @ jacobian for jacobian, weight in parts]
    return np.asarray(sum(pieces)) if pieces else None


def _of_curve(found: Matched) -> FloatArray:
    """What the blocks of a conductor say of its unknowns (28, 28), with what neighbours share."""
    return found.solution.products[:-1, :-1]


def _of_camera(found: Matched) -> FloatArray:
    """What the blocks of a conductor say of the camera (10, 10), whatever its attachments, sag and swing are."""
    information = np.diag(1 / found.survey.prior_sigma() ** 2)
    information[CAMERA, CAMERA] = 0.0
    information += _of_curve(found)
    rest = np.setdiff1d(found.survey.unknowns(), np.arange(CAMERA.stop))
    both = information[CAMERA][:, rest]
    return np.asarray(information[CAMERA, CAMERA] - both @ np.linalg.solve(information[np.ix_(rest, rest)], both.T))


def _sag_u(found: Matched, camera: FloatArray, curve: FloatArray) -> float:
    information = np.diag(1 / found.survey.prior_sigma() ** 2) + curve
    information[CAMERA, CAMERA] += camera
    free = found.survey.unknowns()
    covariance = np.zeros_like(information)
    covariance[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
    return float(np.sqrt(covariance[SAG, SAG]))


def main() -> int:
    parser = argparse.ArgumentParser(description="what stands between the estimate and the limit of a frame")
    parser.add_argument("--groups", default="lab,lab45,tower,field,field-tower,field-ground,side50,side100")
    parser.add_argument("--worlds", type=int, default=6)
    parser.add_argument("--seed", type=int, default=DEVELOPMENT_SEED)
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of limit-terms.md")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    lines = ["| group | conductors | " + " | ".join(COLUMNS) + " |", "|---|---|" + "---|" * len(COLUMNS)]
    print("\n".join(lines))
    for name in options.groups.split(","):
        some = [row for look in looks(name, options.seed, options.worlds) for row in _rows(look)]
        line = f"| {name} | 0 |" + " |" * len(COLUMNS)
        if some:
            middle = np.median(np.array(some), axis=0)
            sags = " | ".join(f"{100 * u:.2f} cm" for u in middle[:-1])
            line = f"| {name} | {len(some)} | {sags} | {100 * middle[-1]:.0f} % |"
        print(line, flush=True)
        lines.append(line)
    command = f"python benchmarks/terms.py --worlds {options.worlds} --seed {options.seed}"
    head = f"# From the limit to what is stated\n\nWritten by `{command}`; do not edit.\n\n{WORDS}\n\n"
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "limit-terms.md").write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    return 0


def _rows(look: Look) -> list[list[float]]:
    even = {name: found for name, found in look.found.items() if not found.survey.load_u}
    say = {name: _of_camera(found) for name, found in even.items()}
    nothing = np.zeros((CAMERA.stop, CAMERA.stop))
    rows = []
    for name, found in even.items():
        of_others = sum((one for other, one in say.items() if other != name), nothing)
        rows.append(terms(look, name, found, of_others))
    return [row for row in rows if row is not None]


if __name__ == "__main__":
    sys.exit(main())
