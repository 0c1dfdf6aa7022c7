"""``python -m sagnode.scene demo`` remakes the demonstration's frames; frames of other spans: ``sagnode scene``.

It gives the same bytes again with the same versions of NumPy and OpenCV on the same kind of processor. Another
NumPy or another instruction set may round an exponential differently in the last place, which moves a few pixels by one
grey level; another OpenCV may write the same picture as other JPEG bytes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code (0 fine, 1 failed, 2 usage or bad configuration)."""
    parser = argparse.ArgumentParser(prog="python -m sagnode.scene", description=(__doc__ or "").split("\n\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    demo = commands.add_parser("demo", help="reference picture and frames of the demonstration's day")
    demo.add_argument("--out", type=Path, required=True, metavar="DIR", help="gets reference.jpg and frames/")
    demo.add_argument("--site", type=Path, metavar="DIR", help="where span.toml and camera.yaml are")
    demo.add_argument("--clicks", action="store_true", help="only print the landmarks' pixels for span.toml")
    args = parser.parse_args(argv)
    return _demo(args.out, args.site, only_clicks=args.clicks)


def _demo(out: Path, site_files: Path | None, *, only_clicks: bool) -> int:
    from sagnode.errors import ConfigError, SagnodeError
    from sagnode.scene.site import clicked, demo_site, write_site

    try:
        site = demo_site(site_files)
        if only_clicks:
            for name, (u, v) in clicked(site.scene).items():
                print(f"{name}: pixel = [{u}, {v}]")
            return 0
        frames = write_site(site, out, progress=_progress if sys.stderr.isatty() else None)
    except SagnodeError as error:
        print(f"sagnode.scene: error: {error}", file=sys.stderr)
        return 2 if isinstance(error, ConfigError) else 1
    print(f"{len(frames)} frames in {out / 'frames'}")
    return 0


def _progress(done: int, total: int) -> None:
    print(f"\rrendered {done}/{total}", end="\n" if done == total else "", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
