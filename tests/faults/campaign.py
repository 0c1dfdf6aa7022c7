"""The fault campaign: real processes, a real broker, real files; what was made, what arrived, and how long it took.

    python tests/faults/campaign.py [--only SECTION,SECTION] [--share 1.0] [--seed 1] [--jobs 2] [--report FILE]

Sections run as processes of their own, ``--jobs`` at a time; inside a section several nodes run side by side, each with
its own directory, broker and books. Each section keeps its result in out/faults, so that single ones can be run again.
At the end the table of all sections is printed, and --report writes it as a document.
"""

import argparse
import ctypes
import importlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
SECTIONS = ("worker", "kill", "camera", "broker", "backlog", "disk", "journal", "clock", "reload", "commands", "power",
            "vm", "fuzz")  # fmt: skip
ALONE = ("backlog",)
"""What measures a promised rate is not disturbed."""
LONGEST_FIRST = (
    "worker",
    "vm",
    "journal",
    "camera",
    "kill",
    "broker",
    "fuzz",
    "power",
    "reload",
    "disk",
    "clock",
    "commands",
)
RESULTS = ROOT / "out" / "faults"
MEMORY_BYTES = 6_000_000_000
"""Address space of the campaign and of each of its processes: what grows beyond that fails, and not the machine."""


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

    def side_by_side(self, *works, at_once):
        """Run works (functions of a campaign of their own) in threads; their lines in order, equal faults added up."""
        place = self.fresh("work")
        own = [Campaign(self.share, self.random.getrandbits(64), place / str(n)) for n in range(len(works))]
        with ThreadPoolExecutor(at_once) as pool:
            ends = [pool.submit(work, campaign) for work, campaign in zip(works, own, strict=True)]
        lines = {}
        for end in ends:
            line = end.result()
            if line.fault in lines:
                lines[line.fault].add(line)
            else:
                lines[line.fault] = line
        return list(lines.values())

    def divided(self, full, nodes):
        """The counts of so many nodes that share a section's faults."""
        count = self.count(full)
        nodes = min(nodes, count)
        return [count // nodes + (n < count % nodes) for n in range(nodes)]


def run_section(name, share, seed, directory=None):
    """The lines of one section."""
    module = importlib.import_module(f"section_{name}")
    with tempfile.TemporaryDirectory(prefix="faults-") as scratch:
        return list(module.run(Campaign(share, f"{seed} {name}", Path(directory or scratch))))


def mounts_of_its_own():
    """Nobody else sees this process's disks, or keeps one alive that is unmounted here; mount_namespaces(7)."""
    libc = ctypes.CDLL(None, use_errno=True)
    private, recursive = 1 << 18, 1 << 14  # MS_PRIVATE, MS_REC
    if libc.unshare(0x20000):  # CLONE_NEWNS; of a process that has no other thread yet
        raise OSError(ctypes.get_errno(), "unshare")
    if libc.mount(b"none", b"/", None, private | recursive, None):
        raise OSError(ctypes.get_errno(), "mount --make-rprivate /")


def this_run():
    """What tells this run of the campaign from any other: the commit it runs at, and when it began."""
    git = ["git", "-C", str(ROOT)]
    commit = subprocess.run([*git, "rev-parse", "--short", "HEAD"], check=False, capture_output=True, text=True)
    # The document itself is what a run writes.
    words = [*git, "status", "--porcelain", "--untracked-files=no", "--", ".", ":!docs/reliability.md"]
    changed = subprocess.run(words, check=False, capture_output=True, text=True).stdout
    name = commit.stdout.strip() or "no commit"
    return f"{name}{', with changes' if changed else ''}, {datetime.now(UTC):%Y-%m-%d %H:%M} UTC"


def one(name, share, seed, run):
    """Run a section here, print its part of the table and keep it; returns the exit code."""
    from table import markdown, save, save_absence

    if os.geteuid() == 0:
        mounts_of_its_own()
    file = RESULTS / f"{name}.json"
    file.unlink(missing_ok=True)  # an old result must not stand for one that broke down
    began = time.monotonic()
    try:
        lines = run_section(name, share, seed)
    except Skip as skip:
        save_absence(file, str(skip))
        print(f"--- {name}: SKIPPED: {skip}", flush=True)
        return 0
    except Exception:  # noqa: BLE001 - outermost loop
        # A section that breaks down is a failed section, and the others are still worth running.
        save_absence(file, "broke down")
        print(f"--- {name}: BROKE DOWN after {time.monotonic() - began:.0f} s\n{traceback.format_exc()}", flush=True)
        return 1
    save(file, lines, time.monotonic() - began, seed, share, run)
    broken = [f"BROKEN: {sentence}\n" for line in lines for sentence in line.verdict()]
    print(f"--- {name}: {time.monotonic() - began:.0f} s\n{markdown(lines)}\n{''.join(broken)}", flush=True)
    return 1 if broken else 0


class Lanes:
    """Sections in processes of their own, so many at once; those of ALONE when no other runs."""

    def __init__(self, jobs, share, seed, run, until):
        self._jobs, self._until = jobs, until
        self._words = [sys.executable, __file__, "--share", str(share), "--seed", str(seed), "--run", run, "--here"]

    def run(self, names):
        shared = [name for name in LONGEST_FIRST if name in names]
        threads = [threading.Thread(target=self._lane, args=(shared,)) for _ in range(self._jobs)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        self._lane([name for name in ALONE if name in names])

    def _lane(self, names):
        from table import save_absence

        while names:
            try:
                name = names.pop(0)
            except IndexError:  # another lane has it
                return
            left = self._until - time.monotonic()
            if left < 1:
                save_absence(RESULTS / f"{name}.json", "there was no time left for it")
                continue
            with tempfile.TemporaryDirectory(prefix="faults-", ignore_cleanup_errors=True) as scratch:
                environment = {**os.environ, "TMPDIR": scratch}
                process = subprocess.Popen([*self._words, "--only", name], start_new_session=True, env=environment)
                try:
                    process.wait(left)
                except subprocess.TimeoutExpired:
                    os.killpg(process.pid, signal.SIGKILL)
                    process.wait()
                    unmount_below(scratch)
                    save_absence(RESULTS / f"{name}.json", "not finished in time")


def unmount_below(directory):
    """Take down what a killed section left mounted."""
    mounts = [line.split()[:2] for line in Path("/proc/mounts").read_text().splitlines()]
    for device, place in reversed(mounts):
        if place.startswith(f"{directory}/"):
            subprocess.run(["umount", "-l", place], check=False, capture_output=True)
            if device.startswith("/dev/loop"):
                subprocess.run(["losetup", "-d", device], check=False, capture_output=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(SECTIONS), help="sections, by commas; '' only reports")
    parser.add_argument("--share", type=float, default=1.0, help="this part of the full counts")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=2, help="sections at once")
    parser.add_argument("--minutes", type=float, default=60.0, help="what is not finished by then is ended")
    parser.add_argument("--report", type=Path, help="write the document here")
    parser.add_argument("--run", help="this run's name; it gives itself one")
    parser.add_argument("--here", action="store_true", help="run the one section in this process")
    args = parser.parse_args()
    names = [name for name in args.only.split(",") if name]
    for name in names:
        if name not in SECTIONS:
            parser.error(f"no section {name!r}; there are {', '.join(SECTIONS)}")
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    if args.here:
        return max(one(name, args.share, args.seed, args.run or this_run()) for name in names)
    import conclusion
    from table import save_run

    began, run = time.monotonic(), this_run()
    Lanes(args.jobs, args.share, args.seed, run, began + args.minutes * 60).run(names)
    if names:
        save_run(RESULTS / "run.json", run, names, time.monotonic() - began)
    return conclusion.conclude(SECTIONS, RESULTS, args)


if __name__ == "__main__":
    for folder in ("faults", "support", "config"):
        sys.path.insert(0, str(HERE.parent / folder))
    if shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin:/usr/local/bin") is None:
        sys.exit("the campaign needs a real broker: apt install mosquitto")
    # The sections import this module by its name.
    sys.modules["campaign"] = sys.modules["__main__"]
    sys.exit(main())
