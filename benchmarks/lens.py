"""What the lens is said to look like, against what was rendered: drops, dirt, fog, night, and ordinary days.

    python benchmarks/lens.py [--worlds 4] [--seed 1] [--out docs/lens.md]

Worlds are those of the accuracy benchmark: a survey, a truth drawn from its uncertainties, a reference picture on a
fair day, and frames with everything drawn at random (light, clouds, sway, sag) but for what the row says. Dirt is
painted on the finished frame: two to five soft, nearly opaque spots of 4 to 16 % of the frame's width. Readings of the
same frames are counted beside it: those told, and those refused with and without the lens, fog or light among the
reasons. The state of the lens refuses nothing.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from sagnode.capture.port import GreyImage
from sagnode.estimate.explain import lens_of
from sagnode.pipeline import load_site, measure_frame
from sagnode.quality import Cause, LensLook, Validity
from sagnode.scene.render import render
from sagnode.scene.spec import Moment
from views import VIEWS
from worlds import Group, any_moment, settle

NAMES = ("tower", "field-tower", "side50", "side")
SEED_OFFSET = 4_000
"""These worlds are none of the accuracy benchmark's."""
NAMED = {Cause.DARK, Cause.FOG, Cause.LENS_WET, Cause.LENS_DIRTY, Cause.LOW_CONTRAST, Cause.OVEREXPOSED}
CONDITIONS: dict[str, tuple[LensLook, Callable[[Moment], Moment]]] = {
    "fair day": (LensLook.CLEAR, lambda m: m),
    "overcast": (LensLook.CLEAR, lambda m: replace(m, cloud=1.0)),
    "low sun": (LensLook.CLEAR, lambda m: replace(m, sun_elevation_deg=3.0, cloud=0.1)),
    "glare": (LensLook.CLEAR, lambda m: replace(m, glare=0.6)),
    "camera turned 12 mrad": (LensLook.CLEAR, lambda m: replace(m, turn_rad=(0.012, -0.012, 0.001))),
    "rain, lens dry": (LensLook.CLEAR, lambda m: replace(m, rain=0.5, cloud=0.95)),
    "dusk": (LensLook.CLEAR, lambda m: replace(m, sun_elevation_deg=-4.0)),
    "mist, 1 km": (LensLook.CLEAR, lambda m: replace(m, fog_per_m=0.004)),
    "fog, 130 m": (LensLook.FOGGED, lambda m: replace(m, fog_per_m=0.03)),
    "fog, 50 m": (LensLook.FOGGED, lambda m: replace(m, fog_per_m=0.08)),
    "lens fogged": (LensLook.FOGGED, lambda m: replace(m, lens="fogged")),
    "drops": (LensLook.WET, lambda m: replace(m, lens="drops")),
    "drops in rain": (LensLook.WET, lambda m: replace(m, lens="drops", rain=0.4, cloud=0.9)),
    "dirt": (LensLook.DIRTY, lambda m: m),
    "night": (LensLook.DARK, lambda m: replace(m, sun_elevation_deg=-14.0)),
    "lens covered": (LensLook.DARK, lambda m: replace(m, lens="covered")),
}


def with_dirt(image: GreyImage, rng: np.random.Generator) -> GreyImage:
    """The frame through a lens with spots of dirt."""
    grey = image.astype(np.float32)
    height, width = grey.shape
    y, x = np.mgrid[:height, :width].astype(np.float32)
    for _ in range(int(rng.integers(2, 6))):
        u, v, radius = rng.uniform(0, width), rng.uniform(0, height), rng.uniform(0.02, 0.08) * width
        distance = np.hypot(x - u, (y - v) * rng.uniform(0.6, 1.6)) / radius
        cover = 0.97 * np.clip((1.2 - distance) * 1.6, 0, 1)
        grey = grey * (1 - cover) + cover * rng.uniform(15, 45)
    return np.asarray(np.clip(grey, 0, 255), dtype=np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(description="rendered conditions against what the lens is said to look like")
    parser.add_argument("--worlds", type=int, default=4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="write the table there as well")
    options = parser.parse_args()
    said: dict[str, Counter[LensLook]] = {name: Counter() for name in CONDITIONS}
    readings: dict[str, Counter[str]] = {name: Counter() for name in CONDITIONS}
    for name in NAMES:
        for index in range(options.worlds):
            with tempfile.TemporaryDirectory(prefix="sagnode-lens-") as folder:
                group = Group(f"lens-{name}", "", VIEWS[name], options.worlds, lambda _: ())
                setting = settle(group, SEED_OFFSET + options.seed, index, Path(folder))
                site = load_site(setting.survey)
            for condition, (_, change) in CONDITIONS.items():
                image = render(setting.scene, change(any_moment(setting))).image
                if condition == "dirt":
                    image = with_dirt(image, setting.rng)
                said[condition][lens_of(site, image).look] += 1
                for measured in measure_frame(site, image):
                    told = measured.validity is not Validity.INVALID
                    named = any(reason.cause in NAMED for reason in measured.reasons)
                    readings[condition]["told" if told else "refused, named" if named else "refused"] += 1
    looks = [look for look in LensLook if any(said[c][look] for c in said)]
    command = f"python benchmarks/lens.py --worlds {options.worlds} --seed {options.seed}"
    lines = [
        "# What the lens looks like",
        "",
        f"Written by `{command} --out docs/lens.md`; do not edit.",
        *(line.strip() for line in (__doc__ or "").split("\n\n", 2)[2].splitlines()),
        "",
        f"| rendered | right | {' | '.join(looks)} | readings told | refused, lens named | refused, not named |",
        "|---|---|" + "---|" * (len(looks) + 3),
    ]
    for condition, (right, _) in CONDITIONS.items():
        counts, outcome = said[condition], readings[condition]
        cells = " | ".join(f"**{counts[look]}**" if look is right else str(counts[look] or "") for look in looks)
        tail = f"{outcome['told']} | {outcome['refused, named']} | {outcome['refused']}"
        lines.append(f"| {condition} | {right} | {cells} | {tail} |")
    every = sum(sum(c.values()) for c in said.values())
    hits = sum(said[c][right] for c, (right, _) in CONDITIONS.items())
    clear = [c for c, (right, _) in CONDITIONS.items() if right is LensLook.CLEAR]
    false = sum(said[c].total() - said[c][LensLook.CLEAR] for c in clear)
    of = sum(said[c].total() for c in clear)
    lines += ["", f"{hits} of {every} frames are named right; {false} of {of} clear ones are called something else."]
    text = "\n".join(lines) + "\n"
    print(text, end="")
    if options.out:
        options.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
