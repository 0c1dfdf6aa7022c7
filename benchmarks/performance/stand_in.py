"""A worker that measures nothing: it speaks the worker's protocol and gives a recorded reply again and again.

Everything but the measuring is then the real node: daemon, journal, broker. Its arguments are the worker's own; the
environment says which reply (``SAGNODE_STAND_IN_REPLY``), how many of them (``SAGNODE_STAND_IN_READINGS``), and which
file system is to be flushed before each (``SAGNODE_STAND_IN_FLUSH``): five minutes between readings are enough for
Linux to write down everything, so a run without pauses must ask for that.
"""

from __future__ import annotations

import ctypes
import json
import os
import sys
import time
from datetime import datetime, timedelta
from pathlib import Path

FIRST = datetime.fromisoformat("2026-06-21T00:00:00+00:00")
STEP = timedelta(minutes=5)


def main() -> None:
    words = dict(zip(sys.argv[1::2], sys.argv[2::2], strict=False))
    reply = json.loads(Path(os.environ["SAGNODE_STAND_IN_REPLY"]).read_text(encoding="utf-8"))
    count = int(os.environ["SAGNODE_STAND_IN_READINGS"])
    flushed = os.environ.get("SAGNODE_STAND_IN_FLUSH")
    resume = words.get("--resume-after")
    done = 0 if resume is None else (datetime.fromisoformat(resume) - FIRST) // STEP + 1
    with (
        os.fdopen(int(words["--requests-fd"]), "rb") as requests,
        os.fdopen(int(words["--replies-fd"]), "wb", buffering=0) as replies,
    ):
        hello = {"kind": "hello", "pid": os.getpid(), "camera": "stand-in", "calibration_id": "none"}
        _say(replies, hello | {"first_frame_at": (FIRST + done * STEP).isoformat()})
        for line in requests:
            request = json.loads(line)["id"]
            if flushed:
                _flush(flushed)
            if done >= count:
                reason = {"cause": "camera-fault", "detail_qual": "failure", "text": "no more"}
                _say(replies, {"kind": "fault", "id": request, "reason": reason, "end_of_frames": True})
                continue
            at = FIRST + done * STEP
            done += 1
            told = {"acquired_at": at.isoformat(), "next_frame_at": (at + STEP).isoformat()}
            _say(replies, reply | {"id": request, "monotonic_s": time.monotonic(), "overlays": {}} | told)


def _say(replies, line: dict) -> None:
    replies.write(json.dumps(line).encode() + b"\n")


def _flush(path: str) -> None:
    """Have the file system of a path write down all it holds, as ``sync -f``."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        ctypes.CDLL(None).syncfs(descriptor)
    finally:
        os.close(descriptor)


if __name__ == "__main__":
    main()
