"""Looks at a group's frames: what the node finds in them, with the truth about the frame beside it."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from groups import groups_by_name
from sagnode.estimate.locate import locate
from sagnode.estimate.matched import Matched
from sagnode.estimate.register import Registered, register
from sagnode.pipeline import load_site
from sagnode.scene.render import Rendered, render
from sagnode.site import Site
from worlds import Shot, settle


@dataclass(frozen=True)
class Look:
    """One frame: the node's site, what was shot, the picture, and the camera and conductors found in it."""

    site: Site
    shot: Shot
    picture: Rendered
    registered: Registered
    found: dict[str, Matched]


def looks(group_name: str, seed: int, worlds: int) -> Iterator[Look]:
    """Every frame of some worlds of a group in which the camera is registered."""
    group = groups_by_name(group_name)[0]
    for index in range(worlds):
        with tempfile.TemporaryDirectory(prefix="sagnode-looks-") as folder:
            setting = settle(group, seed, index, Path(folder))
            site = load_site(setting.survey)
        for shot in group.shots(setting):
            picture = render(shot.scene, shot.moment)
            registered, reasons = register(site, picture.image)
            if not reasons:
                yield Look(site, shot, picture, registered, locate(site, picture.image, registered))
