"""The groups of the suite, in the order of the report."""

from __future__ import annotations

import anywhere
import draws
from views import VIEWS
from worlds import Group

_V = VIEWS
MANY = 36
"""Worlds of an ordinary group: two or three readings each, and a coverage of 95 % that chance moves by 7 %."""

GROUPS = (
    # plain views
    Group("lab", "the paper's laboratory, frontal", _V["lab"], 60, draws.frames(), paper=24),
    Group("lab45", "the paper's laboratory at 45°", _V["lab45"], 60, draws.frames(), paper=24),
    Group(
        "tower",
        "the demonstration's span: camera at tower 1, 5 m below the attachments, 1456x1088, f = 2050 px",
        _V["tower"],
        MANY,
        draws.frames(),
        paper=2,
    ),
    Group(
        "field",
        "the paper's 110 kV span through a long lens from tower 1, 4056x3040, f = 15 300 px",
        _V["field"],
        18,
        draws.frames(),
        paper=1,
    ),
    Group(
        "field-tower",
        "the same span through a short lens, f = 1739 px, surveyed to 5 cm",
        _V["field-tower"],
        MANY,
        draws.frames(),
    ),
    Group(
        "field-ground",
        "the demonstration's span from the ground beside tower 1, looking along the line",
        _V["ground"],
        MANY,
        draws.frames(),
        paper=1,
    ),
    Group("side50", "from the side, 50 m off, f = 540 px, phases above each other", _V["side50"], MANY, draws.frames()),
    Group(
        "side100",
        "from the side, 100 m off, f = 1100 px, phases above each other",
        _V["side"],
        MANY,
        draws.frames(),
        paper=1,
    ),
    Group(
        "side-beside",
        "the paper's 110 kV span from 80 m to its side, f = 800 px, two phases beside each other",
        _V["side-beside"],
        MANY,
        draws.frames(),
    ),
    Group("side200", "from the side, 200 m off, where the wires are 0.12 px wide", _V["side200"], 18, draws.frames()),
    # the conductor
    Group(
        "heights",
        "ends unequal by up to 25 m, from the tower",
        _V["tower"],
        MANY,
        draws.frames(),
        draws.unequal_heights,
    ),
    Group("day", "six frames of a day, from the tower", _V["tower"], 12, draws.day),
    Group(
        "wind",
        "wires swung by up to 30°, from the tower (the survey's prior says so)",
        _V["tower"],
        MANY,
        draws.frames(draws.wind),
        draws.windy,
    ),
    Group("ice", "ice on part of the span, from the tower", _V["tower"], MANY, draws.frames(draws.partial_ice)),
    Group("ice-side", "ice on part of the span, from the side", _V["side"], MANY, draws.frames(draws.partial_ice)),
    Group("weight", "a weight at one place, from the tower", _V["tower"], MANY, draws.frames(draws.point_load)),
    Group("bundle2", "two sub-conductors a phase, from the tower", _V["tower"], MANY, draws.frames(), draws.bundled(2)),
    Group(
        "bundle4", "four sub-conductors a phase, from the tower", _V["tower"], MANY, draws.frames(), draws.bundled(4)
    ),
    # weather and light
    Group("fog", "mist to fog in which nothing is seen, from the tower", _V["tower"], MANY, draws.frames(draws.fog)),
    Group("fog-side", "the same from the side", _V["side"], MANY, draws.frames(draws.fog)),
    Group("rain", "rain, in half of the frames with drops on the lens", _V["tower"], MANY, draws.frames(draws.rain)),
    Group("night", "sun 0 to 8° below the horizon", _V["tower"], MANY, draws.frames(draws.night)),
    Group("glare", "a low sun in the picture or beside it", _V["tower"], MANY, draws.frames(draws.glare)),
    Group(
        "sunlit",
        "bright wires that a low sun lights from one side",
        _V["tower"],
        MANY,
        draws.frames(draws.sunlit),
        world=draws.new_wires,
    ),
    Group("clouds", "strong clouds", _V["tower"], MANY, draws.frames(draws.strong_clouds)),
    # what stands around
    Group(
        "treeline", "wires before a forest, wholly or in part", _V["tower"], MANY, draws.frames(), world=draws.treeline
    ),
    Group(
        "treeline-side", "wires before a forest, from the side", _V["side"], MANY, draws.frames(), world=draws.treeline
    ),
    Group("occlusion", "crowns hide 20 to 40 % of one conductor", _V["tower"], MANY, draws.frames(draws.occluded)),
    Group("occlusion-side", "the same from the side", _V["side"], MANY, draws.frames(draws.occluded)),
    Group("crossing", "another line crosses the span", _V["tower"], MANY, draws.frames(), world=draws.crossed),
    Group("crossing-side", "the same from the side", _V["side"], MANY, draws.frames(), world=draws.crossed),
    # the camera
    Group("sway", "the camera moved by up to 30 px", _V["tower"], MANY, draws.frames(draws.moved(5.0, 30.0))),
    Group("knocked", "the camera moved by 30 to 150 px", _V["tower"], MANY, draws.frames(draws.moved(30.0, 150.0))),
    # sites that nobody has designed for
    Group(
        "any-tower",
        "any span, camera and lens, from the tower",
        _V["field-tower"],
        MANY,
        draws.frames(),
        anywhere.anywhere(anywhere.on_the_tower),
    ),
    Group(
        "any-ground",
        "any span, camera and lens, along the line from the ground",
        _V["field-tower"],
        MANY,
        draws.frames(),
        anywhere.anywhere(anywhere.on_the_ground),
    ),
    Group(
        "any-side",
        "any span, camera and lens, from the side",
        _V["field-tower"],
        MANY,
        draws.frames(),
        anywhere.anywhere(anywhere.aside),
    ),
    # one frame and the next
    Group(
        "repeat-lab",
        "six frames of one moment in the laboratory",
        _V["lab"],
        10,
        draws.same_again(6),
        sequence=True,
    ),
    Group(
        "steps",
        "six frames with steps of sag of 3 cm, from the tower",
        _V["tower"],
        6,
        draws.small_steps(6, 0.03),
        sequence=True,
    ),
    # what must not be told
    Group("none-tower", "negatives from the tower", _V["tower"], 50, draws.negatives),
    Group("none-field", "negatives in the field, short lens", _V["field-tower"], 14, draws.negatives),
    Group("none-ground", "negatives from the ground", _V["ground"], 14, draws.negatives),
    Group("none-side", "negatives from the side", _V["side"], 20, draws.negatives),
    Group(
        "none-any-tower",
        "negatives from any tower",
        _V["field-tower"],
        20,
        draws.negatives,
        anywhere.anywhere(anywhere.on_the_tower),
    ),
    Group(
        "none-any-side",
        "negatives from any side",
        _V["field-tower"],
        20,
        draws.negatives,
        anywhere.anywhere(anywhere.aside),
    ),
    Group(
        "none-side-beside",
        "negatives from the side, two phases beside each other",
        _V["side-beside"],
        20,
        draws.negatives,
    ),
    Group("none-lab", "negatives in the laboratory", _V["lab"], 20, draws.negatives),
    Group("none-lab45", "negatives in the laboratory at 45°", _V["lab45"], 20, draws.negatives),
)


def groups_by_name(names: str | None) -> list[Group]:
    """The groups of a comma-separated list, all without one.

    Raises:
        ValueError: a name is not known.
    """
    known = {group.name: group for group in GROUPS}
    if names is None:
        return list(GROUPS)
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    strange = [name for name in wanted if name not in known]
    if strange:
        raise ValueError(f"no group {', '.join(strange)}; there are {', '.join(known)}")
    return [known[name] for name in wanted]
