"""The fault campaign: real processes, a real broker, real files; what was made, what arrived, and how long it took.

    python tests/faults/campaign.py [--only SECTION,SECTION] [--share 1.0] [--seed 1] [--report FILE]

Each section keeps its result in out/faults, so that the campaign can be stopped and gone on with by --only. At the end
the table of all sections that were ever run is printed, and --report writes it as a document.
"""

import argparse
import importlib
import random
import shutil
import sys
import tempfile
import time
import traceback
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
SECTIONS = ("worker", "kill", "camera", "broker", "backlog", "disk", "journal", "clock", "reload", "power", "fuzz")
RESULTS = ROOT / "out" / "faults"


class Skip(Exception):
    """This section cannot run here; the text says what is missing."""


class Campaign:
    """What a section is given: its own directories, its share of the faults, a seeded source of randomness."""

    def __init__(self, share, seed, directory):
        self.share = share
        self.random = random.Random(seed)
        self._directory = directory
        self._number = 0

    def fresh(self, name):
        self._number += 1
        place = self._directory / f"{name}-{self._number}"
        place.mkdir(parents=True)
        return place

    def count(self, full):
        return max(2, round(full * self.share))

    def seconds(self, full):
        return max(1.0, full * min(1.0, self.share))


def run_section(name, share, seed, directory=None):
    """The lines of one section."""
    module = importlib.import_module(f"section_{name}")
    with tempfile.TemporaryDirectory(prefix="faults-") as scratch:
        return list(module.run(Campaign(share, seed, Path(directory or scratch))))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(SECTIONS), help="sections, by commas; '' only reports")
    parser.add_argument("--share", type=float, default=1.0, help="this part of the full counts")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--report", type=Path, help="write the document here")
    args = parser.parse_args()
    import conclusion
    from table import markdown, save

    skipped = {}
    for name in filter(None, args.only.split(",")):
        if name not in SECTIONS:
            parser.error(f"no section {name!r}; there are {', '.join(SECTIONS)}")
        began = time.monotonic()
        print(f"--- {name}", flush=True)
        try:
            lines = run_section(name, args.share, args.seed)
        except Skip as skip:
            skipped[name] = str(skip)
            print(f"SKIPPED: {skip}", flush=True)
            continue
        except Exception:  # noqa: BLE001 - outermost loop
            # A section that breaks down is a failed section, and the others are still worth running.
            traceback.print_exc()
            skipped[name] = "broke down"
            continue
        save(RESULTS / f"{name}.json", lines, time.monotonic() - began, args.seed, args.share)
        print(markdown(lines), flush=True)
        for line in lines:
            for sentence in line.verdict():
                print(f"BROKEN: {sentence}", flush=True)
        print(f"--- {name}: {time.monotonic() - began:.0f} s\n", flush=True)
    return conclusion.conclude(SECTIONS, RESULTS, args, skipped)


if __name__ == "__main__":
    for folder in ("faults", "support", "config"):
        sys.path.insert(0, str(HERE.parent / folder))
    if shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin") is None:
        sys.exit("the campaign needs a real broker: apt install mosquitto")
    # The sections import this module by its name.
    sys.modules["campaign"] = sys.modules["__main__"]
    sys.exit(main())
