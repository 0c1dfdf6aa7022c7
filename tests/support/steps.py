"""What remains when a process is killed between any two lines of its code: each line is tried, on real files."""

import os
import signal
import sys
from pathlib import Path

import sagnode.daemon

PACKAGE = str(Path(sagnode.daemon.__file__).parent)


def lines_of(work):
    """The lines of the daemon's code that ``work`` passes, each once, in the order in which it comes to them."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        _forked(work, lambda place: os.write(writer, f"{place[0]} {place[1]}\n".encode()))
    os.close(writer)
    with os.fdopen(reader) as stream:
        passed = [tuple(line.split()) for line in stream]
    _, status = os.waitpid(child, 0)
    assert status == 0, f"the work itself failed: {status}"
    return [(file, int(number)) for file, number in passed]


def killed_before(work, line):
    """Do ``work`` in a process that is killed (SIGKILL) when it comes to that line for the first time."""
    child = os.fork()
    if child == 0:
        _forked(work, lambda place: os.kill(os.getpid(), signal.SIGKILL) if place == line else None)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status), f"never came to {line}"


def _forked(work, arrived):
    """The whole life of the child: none of what the parent would do at its end is done here."""
    seen = set()

    def trace(frame, event, _):
        file = frame.f_code.co_filename
        if not file.startswith(PACKAGE):
            return None
        place = file, frame.f_lineno
        if event == "line" and place not in seen:
            seen.add(place)
            arrived((file.rpartition("/")[2], frame.f_lineno))
        return trace

    code = 1
    try:
        sys.settrace(trace)
        work()
        code = 0
    finally:
        os._exit(code)
