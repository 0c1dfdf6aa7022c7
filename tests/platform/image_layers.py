"""Resolves deploy/image as rpi-image-gen does, and writes the words for bdebstrap, one a line.

    python3 tests/platform/image_layers.py CHECKOUT-OF-RPI-IMAGE-GEN DIRECTORY

Left out is what only Raspberry Pi's own archive has: the layers of :data:`THEIRS` and the packages of
:data:`THEIR_PACKAGES`. DIRECTORY takes the layers as they are used.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

IMAGE = Path(__file__).parents[2] / "deploy" / "image"
THEIRS = {"rpi-debian-trixie"}
THEIR_PACKAGES = {"python3-picamera2"}
_FIELD = re.compile(r"^# X-Env-([\w-]+): ?(.*)$")


@dataclass(frozen=True)
class Layer:
    """One layer's file, what it asks for, and the variables that it declares, with their defaults."""

    file: Path
    requires: tuple[str, ...]
    variables: dict[str, str]


def read_layer(file: Path) -> tuple[str, Layer] | None:
    """A layer by its name, out of the comments at its head; None where the file is none."""
    fields = dict(found.groups() for line in file.read_text().splitlines() if (found := _FIELD.match(line)))
    name = fields.get("Layer-Name")
    if name is None:
        return None
    prefix = fields.get("VarPrefix", "")
    declared = {key.removeprefix("Var-"): value for key, value in fields.items() if re.fullmatch(r"Var-\w+", key)}
    wanted = tuple(word.strip() for word in fields.get("Layer-Requires", "").split(",") if word.strip())
    return name, Layer(file, wanted, {f"IGconf_{prefix}_{key}": value for key, value in declared.items()})


def in_order(name: str, layers: dict[str, Layer], seen: set[str]) -> Iterator[Layer]:
    """A layer after all that it asks for, each once."""
    if name in seen or name in THEIRS:
        return
    seen.add(name)
    for wanted in layers[name].requires:
        yield from in_order(wanted, layers, seen)
    yield layers[name]


def settings(config: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """The variables of a configuration file: its sections are prefixes, a list counts from 0."""
    for section, content in config.items():
        if section in ("include", "layer"):
            continue
        pairs = enumerate(content) if isinstance(content, list) else content.items()
        for key, value in pairs:
            yield f"IGconf_{section}_{key}", str(value)


def without_theirs(file: Path, directory: Path) -> Path:
    """The layer without packages that Debian has not; the very file where it asks for none."""
    data = yaml.safe_load(file.read_text())
    packages = data["mmdebstrap"].get("packages", [])
    if not THEIR_PACKAGES & set(packages):
        return file
    packages[:] = [name for name in packages if name not in THEIR_PACKAGES]
    copy = directory / file.name
    copy.write_text(yaml.safe_dump(data))
    return copy


def main(words: list[str]) -> int:
    """Print the words."""
    checkout, directory = Path(words[0]), Path(words[1])
    config = yaml.safe_load((IMAGE / "config" / "sagnode.yaml").read_text())
    files = [*(checkout / "layer").rglob("*.yaml"), *(IMAGE / "layer").glob("*.yaml")]
    layers = dict(found for file in files if (found := read_layer(file)))
    plan = list(in_order(config["layer"]["app"], layers, set()))
    variables = {key: value for layer in plan for key, value in layer.variables.items()}
    variables |= dict(settings(config))
    for key, value in variables.items():
        print("--env")
        print(f"{key}={value}")
    for layer in plan:
        if not (yaml.safe_load(layer.file.read_text()) or {}).get("mmdebstrap"):
            continue  # it declares variables only
        overlay = layer.file.with_name(f"{layer.file.stem}.rootfs-overlay")
        if overlay.is_dir():
            hook = {
                "mmdebstrap": {"customize-hooks": [f'rsync -a --exclude=.keep --exclude=.empty "{overlay}/" "$1/"']}
            }
            file = directory / f"{layer.file.stem}.pre.yaml"
            file.write_text(yaml.safe_dump(hook))
            print("--config")
            print(file)
        print("--config")
        print(without_theirs(layer.file, directory))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
