"""A real child process that speaks the worker's protocol and misbehaves when told to.

The words of the plan (a file, one word per request; the last one repeats) are taken in turn, also across restarts:
ok, hang, hang-children, crash, segfault, abort, garbage, half-line, long-line, wrong-id, fault, camera-fault, fatal,
end, slow:<seconds>, sag:<metres>, leak:<megabytes>, chatty, flood.
Before the first request: no-hello, bad-hello, die-at-start, start-fault.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

parser = argparse.ArgumentParser()
parser.add_argument("--plan", type=Path)
parser.add_argument("--requests-fd", type=int)
parser.add_argument("--replies-fd", type=int)
parser.add_argument("--resume-after", default=None)
parser.add_argument("--conductors", default="L1,L2")
parser.add_argument("--frames-from", default=None)
args = parser.parse_args()
requests = os.fdopen(args.requests_fd, "rb")
replies = os.fdopen(args.replies_fd, "wb", buffering=0)
FRAME_STEP = timedelta(minutes=15)


def say(line):
    replies.write(line if isinstance(line, bytes) else json.dumps(line).encode() + b"\n")


def next_word():
    words = args.plan.read_text().split()
    if not words:
        return "ok"
    if len(words) > 1:
        args.plan.write_text(" ".join(words[1:]))
    return words[0]


def reason(cause, text):
    words = {"worker-crashed": "failure", "camera-fault": "failure", "bad-frame": "failure", "dark": "failure"}
    return {"cause": cause, "detail_qual": words[cause], "text": text}


def frame_at():
    if args.frames_from is None:
        return None
    if args.resume_after is not None:
        first = datetime.fromisoformat(args.frames_from)
        after = datetime.fromisoformat(args.resume_after)
        while first <= after:
            first += FRAME_STEP
        return first
    return datetime.fromisoformat(args.frames_from)


def result(conductor, sag=8.0):
    return {
        "conductor": conductor,
        "validity": "good",
        "estimates": {"sag": [sag, 0.01, sag - 0.02, sag + 0.02], "clearance": [7.5, 0.05, 7.4, 7.6]},
        "frames_used": 1,
        "method": "stand-in",
    }


frame = frame_at()
starting = args.plan.read_text().split()[:1]
if starting == ["no-hello"]:
    next_word()
    time.sleep(3600)
if starting == ["die-at-start"]:
    next_word()
    print("cannot find my camera library", file=sys.stderr, flush=True)
    sys.exit(3)
if starting == ["bad-hello"]:
    next_word()
    say(b'{"kind": "hello", "pid": "yes"}\n')
    time.sleep(3600)
if starting == ["start-fault"]:
    next_word()
    say({"kind": "fault", "reason": reason("camera-fault", "/dev/video9: no such device"), "fatal": True})
    sys.exit(70)
say(
    {
        "kind": "hello",
        "pid": os.getpid(),
        "camera": "stand-in",
        "calibration_id": "cal-1",
        "first_frame_at": frame and frame.isoformat(),
    }
)
hoard = []
for line in requests:
    request = json.loads(line)
    word, _, argument = next_word().partition(":")
    if word == "hang":
        time.sleep(3600)
    elif word == "hang-children":
        subprocess.Popen(["sleep", "3600"], pass_fds=(args.replies_fd,))
        time.sleep(3600)
    elif word == "crash":
        print("about to fail", file=sys.stderr, flush=True)
        sys.exit(1)
    elif word == "segfault":
        os.kill(os.getpid(), 11)
    elif word == "abort":
        os.abort()
    elif word == "garbage":
        say(b"\x80\x04\x95 pickled nonsense\n")
        continue
    elif word == "half-line":
        say(b'{"kind": "reply", "id": ')
        sys.exit(0)
    elif word == "long-line":
        say(b"x" * 1_500_000)
        time.sleep(3600)
    elif word == "flood":
        while True:
            say(b"y" * 4096 + b"\n")
    elif word == "fault":
        say({"kind": "fault", "id": request["id"], "reason": reason("dark", "median grey 3 of 255")})
        frame = frame and frame + FRAME_STEP
        continue
    elif word == "camera-fault":
        say({"kind": "fault", "id": request["id"], "reason": reason("camera-fault", "no frame in 5 s")})
        continue
    elif word == "fatal":
        say(
            {
                "kind": "fault",
                "id": request["id"],
                "reason": reason("worker-crashed", "out of memory"),
                "fatal": True,
            }
        )
        sys.exit(70)
    elif word == "end":
        say({"kind": "fault", "id": request["id"], "reason": reason("camera-fault", "no more"), "end_of_frames": True})
        continue
    elif word == "slow":
        time.sleep(float(argument))
    elif word == "leak":
        hoard.append(b"x" * (int(argument) * 1_000_000))
    elif word == "chatty":
        print("noise on stdout " * 20_000, flush=True)
        print("noise on stderr " * 20_000, file=sys.stderr, flush=True)
    acquired = frame or datetime.now(UTC)
    frame = frame and frame + FRAME_STEP
    say(
        {
            "kind": "reply",
            "id": request["id"] + (7 if word == "wrong-id" else 0),
            "acquired_at": acquired.isoformat(),
            "monotonic_s": time.monotonic(),
            "camera": "stand-in",
            "results": [result(c, float(argument) if word == "sag" else 8.0) for c in args.conductors.split(",")],
            "elapsed_s": 0.01,
            "memory_mb": 50.0 + sum(len(h) for h in hoard) / 1e6,
            "next_frame_at": frame and frame.isoformat(),
        }
    )
