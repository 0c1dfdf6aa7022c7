"""What stands between the estimate and the least-squares limit of a frame; by group.

    python benchmarks/terms.py [--groups tower,field,lab45,side100] [--worlds 6] [--seed 1] [--out docs]

The limit (`benchmarks/limit.py`) takes the clicks for exact but for their click, the whole visible wire as seen, and no
noise but the sensor's. Here its parts are replaced one by one by what the node had of the very same frame: its tracked
landmarks; the places at which it measured the wire; how uncertain each of those looks before its background; what
neighbours share (which makes it what the node states). Each step is a factor on the standard uncertainty of sag.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from limit import across, information_per_pixel, landmark_information, true_theta
from looks import Look, looks
from run import DEVELOPMENT_SEED
from sagnode.estimate.matched import Matched
from sagnode.geometry.camera import FloatArray
from sagnode.scene.render import Rendered
from sagnode.scene.spec import Moment
from sagnode.survey import CAMERA, SAG

ROOT = Path(__file__).resolve().parents[1]
GROUPS = (
    "lab,lab45,tower,field,field-tower,field-ground,side50,side100,side200,side-beside,day,wind,bundle2,fog,rain,glare,"
    "sunlit,clouds,treeline,occlusion,crossing,any-tower,any-ground,any-side"
)
STEPS = ("landmarks", "only where measured", "what is behind", "what they share")
TOLD = 0.04
"""Share of sag above which a standard uncertainty is refused; of such conductors nothing is told."""
WORDS = """\
The least-squares limit of a frame takes every clicked landmark to be found again exactly, every pixel of the visible
wire to be measured, and the sensor's noise for the only noise. What the node had of the very same frames takes the
place of these one by one. Each column is the median factor by which the standard uncertainty of sag grows by that;
conductors that were taken for evenly loaded, and are sure to 4 % of their sag.

- **limit**: as `docs/accuracy.md` uses it, median.
- **landmarks**: as they were tracked.
- **only where measured**: only those stretches of the wire that were measured. What is lost here is lost where it
  hides behind or beside other wires, and where it shows in so few grey levels before what is behind it that no reader
  finds it; the limit counts those as seen.
- **what is behind**: each stretch as uncertain as it looks before its background: texture and edges, which are no noise
  of the sensor.
- **what they share**: errors that neighbouring stretches have in common. This is what the node states.
- **stated over limit**: all of them together; the median, how many are above 1.5, and the root mean square, which
  single wide readings rule.
- **others' curves**: what the stated one would be multiplied by, were the camera also held by what the span's other
  conductors say of it, as it would be in one estimate for all (decision 2 says why there is none)."""


def terms(look: Look, name: str, found: Matched, of_others: FloatArray) -> list[float] | None:
    """Standard uncertainties of sag, m, with more and more of what the node had; None without a wire in the frame.

    ``of_others`` (10, 10) is what the other conductors say of the camera.
    """
    true = next(c for c in look.shot.scene.true.conductors if c.id == name)
    survey, solution = found.survey, found.solution
    theta = true_theta(survey, look.shot.scene, look.shot.moment, true)
    landmarks = landmark_information(look.site, survey, theta)
    wires = list(_wires(found, theta, look.picture, name, look.shot.moment))
    if not wires:
        return None
    whole = _summed((jacobian, weight) for _, jacobian, weight in wires)
    met = _summed((jacobian, weight * _was_measured(found, place)) for place, jacobian, weight in wires)
    jacobian = solution.jacobian
    blocks = jacobian.T @ (jacobian / solution.white[:, None])
    shared = _of_curve(found)
    own = look.registered.camera.precision
    steps = [(landmarks, whole), (own, whole), (own, met), (own, blocks), (own, shared), (own + of_others, shared)]
    return [_sag_u(found, camera, curve) for camera, curve in steps]


def _wires(
    found: Matched, theta: FloatArray, picture: Rendered, name: str, moment: Moment
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Place (N,), derivatives (N, 28) and information (N,) of every pixel of the length of each visible wire."""
    for wire in picture.seen.get(name, ()):
        if wire.place.size >= 2:
            jacobian = across(found.survey, theta, wire.place)
            kept = np.isfinite(jacobian).all(axis=1)
            yield wire.place[kept], jacobian[kept], information_per_pixel(wire, moment)[kept]


def _was_measured(found: Matched, place: FloatArray) -> NDArray[np.bool_]:
    """Which places (N,) of the span lie in a block that was measured, (N,)."""
    t = found.observed.t
    return np.asarray(found.observed.usable[np.abs(place[:, None] - t).argmin(axis=1)])


def _summed(parts: Iterable[tuple[FloatArray, FloatArray]]) -> FloatArray:
    return np.asarray(sum((jacobian * weight[:, None]).T @ jacobian for jacobian, weight in parts))


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
    parser.add_argument("--groups", default=GROUPS)
    parser.add_argument("--worlds", type=int, default=6)
    parser.add_argument("--seed", type=int, default=DEVELOPMENT_SEED)
    parser.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of limit-terms.md")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    titles = ("group", "conductors", "limit", *STEPS, "stated over limit", "above 1.5", "rms", "others' curves")
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    print("\n".join(lines))
    for name in options.groups.split(","):
        some = [row for look in looks(name, options.seed, options.worlds) for row in _rows(look)]
        lines.append(f"| {name} | " + " | ".join(_cells(np.array(some), len(titles) - 1)) + " |")
        print(lines[-1], flush=True)
    command = f"python benchmarks/terms.py --worlds {options.worlds} --seed {options.seed}"
    head = f"# From the limit to what is stated\n\nWritten by `{command}`; do not edit.\n\n{WORDS}\n\n"
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "limit-terms.md").write_text(head + "\n".join(lines) + "\n", encoding="utf-8")
    return 0


def _cells(some: FloatArray, columns: int) -> list[str]:
    """What a group's line says of the standard uncertainties (N, 6) of its conductors."""
    if not len(some):
        return ["0", *("–" * (columns - 1))]
    steps = np.median(some[:, 1:] / some[:, :-1], axis=0)
    stated = some[:, 4] / some[:, 0]
    return [
        f"{len(some)}",
        f"{100 * np.median(some[:, 0]):.2f} cm",
        *(f"{step:.2f}" for step in steps[:4]),
        f"{np.median(stated):.2f}",
        f"{np.mean(stated > 1.5):.0%}".replace("%", " %"),
        f"{np.sqrt(np.mean(stated**2)):.2f}",
        f"{steps[4]:.2f}",
    ]


def _rows(look: Look) -> list[list[float]]:
    even = {name: found for name, found in look.found.items() if not found.survey.load_u}
    even = {name: found for name, found in even.items() if found.sag[1] < TOLD * found.sag[0]}
    say = {name: _of_camera(found) for name, found in even.items()}
    nothing = np.zeros((CAMERA.stop, CAMERA.stop))
    rows = []
    for name, found in even.items():
        of_others = sum((one for other, one in say.items() if other != name), nothing)
        rows.append(terms(look, name, found, of_others))
    return [row for row in rows if row is not None]


if __name__ == "__main__":
    sys.exit(main())
