"""A node of a test's own on the disk, its daemon as a process, and what is seen of it from outside."""

import contextlib
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import time
from importlib.resources import files
from pathlib import Path

SITE = Path(str(files("sagnode.demo") / "site"))
"""The demonstration's survey, calibration, reference picture and frames."""
NO_CAMERA = 'backend = "v4l2"\nv4l2 = { device = "/dev/video99" }'
"""Makes invalid readings, which are readings too."""


def copy_site(directory):
    """The demonstration's survey, lens and reference picture, where they are not there yet."""
    for file in ("span.toml", "camera.yaml", "reference.jpg"):
        if not (directory / file).exists():
            shutil.copy(SITE / file, directory)


def write_node(
    directory,
    camera=NO_CAMERA,
    schedule="interval_s = 0.5\ndeadline_s = 30",
    more="",
    before="",
    state="state",
    backoff_max_s=1.0,
):
    """The demonstration's survey and a node file beside it; ``more`` goes on in [storage]; returns the node file."""
    copy_site(directory)
    node = directory / "node.toml"
    node.write_text(
        f"""
span_file = "span.toml"
{before}
[unit]
utility = "u"
line = "l"
span = "s"
unit = "n"
[camera]
{camera}
[schedule]
{schedule}
[worker]
backoff_max_s = {backoff_max_s}
[storage]
state_dir = "{state}"
{more}
"""
    )
    return node


def start_daemon(node, log, **environment):
    """The daemon as a process of its own; its words are appended to ``log``."""
    env = {k: v for k, v in os.environ.items() if k not in {"STATE_DIRECTORY", "RUNTIME_DIRECTORY"}}
    words = [sys.executable, "-m", "sagnode", "run", "--config", str(node)]
    with log.open("ab") as stream:
        return subprocess.Popen(words, stdout=stream, stderr=stream, env={**env, **environment})


def status(directory):
    """What the daemon with this node file shows of itself; None before it does."""
    with contextlib.suppress(OSError):
        return json.loads((directory / "state" / "status.json").read_text())
    return None


def readings(directory):
    """The journal's readings, oldest first."""
    with contextlib.closing(sqlite3.connect(directory / "state" / "journal.sqlite")) as db:
        return [json.loads(text) for (text,) in db.execute("SELECT json FROM readings ORDER BY sequence")]


def wait_for(condition, seconds=30.0, told=lambda: ""):
    """What ``condition`` gives as soon as it gives anything; fails when that takes too long, with what is ``told``."""
    until = time.monotonic() + seconds
    while not (result := condition()):
        assert time.monotonic() < until, f"not in {seconds} s; {told()}"
        time.sleep(0.02)
    return result
