"""The report of ``appearances.py``: what was counted, and how it is told."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sagnode.estimate.register import Registered

WRONG = 5.0
K95 = 1.96


@dataclass
class Tally:
    """What was seen of one way to register."""

    frames: int = 0
    visible: int = 0
    found: int = 0
    lost: int = 0
    pixels: list[float] = field(default_factory=list)
    """Errors of the pose."""
    z: list[float] = field(default_factory=list)
    """The same over their standard uncertainty."""
    aside: list[float] = field(default_factory=list)
    """From the pose that all landmarks would give."""

    def take(self, registered: Registered, refused: bool, error: tuple[float, float, float] | None) -> None:
        """Count one frame."""
        self.frames += 1
        tracked = registered.tracked
        self.visible += int(tracked.visible.sum()) if tracked is not None else 0
        self.lost += refused
        if not refused and tracked is not None and error is not None:
            self.found += tracked.count
            self.pixels.append(error[0])
            self.z.append(error[1])
            self.aside.append(error[2])

    def row(self, name: str) -> str:
        """A line of the table."""
        if not self.pixels:
            return f"| {name} | {self.frames} | – | {self.lost} | – | – | – | – | – | – |"
        z, pixels = np.abs(self.z), np.array(self.pixels)
        return (
            f"| {name} | {self.frames} | {100 * self.found / max(self.visible, 1):.1f} % | {self.lost} |"
            f" {np.quantile(self.aside, 0.5):.2f} | {np.quantile(self.aside, 0.95):.2f} |"
            f" {np.median(pixels):.2f} | {np.quantile(pixels, 0.95):.2f} | {np.sqrt(np.mean(z**2)):.2f} |"
            f" {int(np.sum(z > WRONG))} |"
        )


@dataclass
class Outcome:
    """Of one world."""

    without: Tally = field(default_factory=Tally)
    kept: Tally = field(default_factory=Tally)
    helped: Tally = field(default_factory=Tally)
    """The frames in which appearances found a landmark, registered with them."""
    unhelped: Tally = field(default_factory=Tally)
    """The same frames without them, where they are not lost."""
    places: list[float] = field(default_factory=list)
    """Errors of landmarks found by an appearance, px, along one axis."""
    readings: list[tuple[bool, bool, float]] = field(default_factory=list)
    """Frames measured: told without, told with, and the error over its uncertainty of sag with appearances."""
    negatives: int = 0
    believed: int = 0
    believed_by_appearance: int = 0
    appearances: int = 0


INTRODUCTION = """\
# Landmarks through light, season and weather

Written by `python benchmarks/appearances.py --worlds {worlds} --seed {seed}`; do not edit. Worlds with drawn survey
errors are seen on days through a year: the sun's side and the shaded side, shadows across targets, bare trees,
snow, haze, overcast days, dusk. In a quarter of the frames something hides a landmark, and one landmark of every
world is moved by decimetres in the middle of the year. Every frame is registered by the reference picture alone,
and with the appearances that the frames before it have left ([decision 7](decisions/0007-landmark-appearances.md)).

- **landmarks found**: of those that the reference picture shows; none in frames that are refused.
- **lost**: frames refused for their landmarks.
- **off**: where the camera is thought to see the middle of the visible conductor, against where it would be thought to
  with every landmark found exactly; median, and what 95 % of the frames are below.
- **error**: the same against the truth; **u**: its stated standard uncertainty along an axis (root mean square of the
  ratio). The survey's errors are one draw for all frames of a world, and most of the error.
"""

HEAD = """\
| | frames | landmarks found | lost | off, px | 95 % of off | error, px | 95 % of error | error / u | beyond 5 u |
|---|---|---|---|---|---|---|---|---|---|"""

REST = """
{places} landmarks were found by an appearance, {off:.2f} px off along an axis (root mean square; 0.3 px is what they
are given), {far:.1%} of the coordinates by more than 1 px.

Conductors measured in such frames: {measured}. Told by the reference alone: {before}; with appearances: {after},
of which {held:.0%} hold the true sag in their 95 % interval, and {wrong} are beyond five of their
standard uncertainties.

Pictures of something else (turned away, fogged lens, clutter), with all appearances at hand: {negatives}. Taken for the
view: {believed}, by appearances: {by_appearance}. Usable appearances at the end: {usable} in {worlds} worlds.
"""


def merged(tallies: list[Tally]) -> Tally:
    """All of them together."""
    whole = Tally()
    for one in tallies:
        whole.frames += one.frames
        whole.visible += one.visible
        whole.found += one.found
        whole.lost += one.lost
        whole.pixels += one.pixels
        whole.z += one.z
        whole.aside += one.aside
    return whole


def document(outcomes: dict[str, list[Outcome]], seed: int) -> str:
    """The report."""
    every = [o for of_view in outcomes.values() for o in of_view]
    lines = [INTRODUCTION.format(worlds=len(every) // len(outcomes), seed=seed), HEAD]
    for view, of_view in {**outcomes, "all": every}.items():
        lines.append(merged([o.without for o in of_view]).row(f"{view}, reference alone"))
        lines.append(merged([o.kept for o in of_view]).row(f"{view}, with appearances"))
    lines += ["", "Frames in which an appearance found a landmark:", "", HEAD]
    lines.append(merged([o.unhelped for o in every]).row("reference alone"))
    lines.append(merged([o.helped for o in every]).row("with appearances"))
    places = np.array([e for o in every for e in o.places] or [np.nan])
    readings = [r for o in every for r in o.readings]
    z = np.abs([r[2] for r in readings if r[1]] or [np.nan])
    lines.append(
        REST.format(
            places=len(places) // 2,
            off=np.sqrt(np.mean(places**2)),
            far=np.mean(np.abs(places) > 1),
            measured=len(readings),
            before=sum(r[0] for r in readings),
            after=sum(r[1] for r in readings),
            held=np.mean(z <= K95),
            wrong=int(np.sum(z > WRONG)),
            negatives=sum(o.negatives for o in every),
            believed=sum(o.believed for o in every),
            by_appearance=sum(o.believed_by_appearance for o in every),
            usable=sum(o.appearances for o in every),
            worlds=len(every),
        )
    )
    return "\n".join(lines)
