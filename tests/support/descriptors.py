"""File descriptors: how many a process has, and what happens when there are many."""

import contextlib
import os
import resource
from pathlib import Path


def descriptors(pid="self"):
    """What the descriptors of a process point at."""
    found = []
    for entry in os.scandir(f"/proc/{pid}/fd"):
        with contextlib.suppress(FileNotFoundError):
            found.append(str(Path(entry.path).readlink()))
    return found


@contextlib.contextmanager
def all_low_ones_taken():
    """Whatever is opened meanwhile gets a number above 1023, which select(2) does not know."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, 2048), hard))
    taken = [os.open(os.devnull, os.O_RDONLY)]
    try:
        while taken[-1] < 1024:
            taken.append(os.dup(taken[0]))
        yield
    finally:
        for one in taken:
            os.close(one)
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
