"""Memory of the worker is limited in growth, and it does not outlive its parent."""

import subprocess
import sys
import time
from pathlib import Path

import pytest


def run(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=30)


@pytest.mark.parametrize(("megabytes", "fits"), [(50, True), (400, False)])
def test_growth_is_limited_whatever_was_mapped_before(megabytes, fits):
    done = run(
        "import mmap\n"
        "from sagnode.worker.confine import limit_growth\n"
        "before = mmap.mmap(-1, 500_000_000)\n"  # what libraries map and never touch
        "limit_growth(200)\n"
        "try:\n"
        f"    data = bytearray({megabytes} * 1_000_000)\n"
        "    print('fits')\n"
        "except MemoryError:\n"
        "    print('refused')\n"
    )
    assert done.stdout.strip() == ("fits" if fits else "refused"), done.stderr


def test_it_dies_with_its_parent():
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            (
                "import os, subprocess, sys, time\n"
                "child = subprocess.Popen([sys.executable, '-c', 'import sys, time;'\n"
                "    'from sagnode.worker.confine import die_with_parent;'\n"
                "    'print(die_with_parent(int(sys.argv[1])), flush=True); time.sleep(60)', str(os.getpid())],\n"
                "    stdout=subprocess.PIPE, text=True, start_new_session=True)\n"
                "print(child.stdout.readline().strip(), child.pid, flush=True)\n"
                "time.sleep(60)\n"
            ),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    said, pid = parent.stdout.readline().split()
    assert said == "True"
    parent.kill()
    parent.wait()
    until = time.monotonic() + 5
    stat = Path(f"/proc/{pid}/stat")
    while stat.exists() and stat.read_text().rpartition(")")[2].split()[0] != "Z":
        assert time.monotonic() < until
        time.sleep(0.02)


def test_a_parent_that_has_gone_already_is_noticed():
    assert (
        run("from sagnode.worker.confine import die_with_parent; print(die_with_parent(1))").stdout.strip() == "False"
    )
