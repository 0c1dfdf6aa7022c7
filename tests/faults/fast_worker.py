"""A worker that measures nothing and fails in every way there is: started by the real daemon in place of the real one.

Its numbers are functions of a token (``coded.py``). It writes a ledger, a line for each thing that it does, with the
monotonic time: ``G token`` before a good reply, ``F kind`` before a fault. Between two faults it gives one good reply,
unless it is to fail always.

    fast_worker.py REQUESTS_FD REPLIES_FD LEDGER CONDUCTORS [always] [KIND...]
"""

import json
import os
import sys
import time

sys.path.insert(0, __file__.rpartition("/")[0])
from coded import estimate

requests = os.fdopen(int(sys.argv[1]), "rb")
replies = int(sys.argv[2])
ledger = os.open(sys.argv[3], os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
conductors = sys.argv[4].split(",")
always = sys.argv[5:6] == ["always"]
kinds = sys.argv[6:] if always else sys.argv[5:]


def note(text):
    """G: a good reply follows; P: one that is partly good; F: a fault."""
    os.write(ledger, f"{time.monotonic():.6f} {text}\n".encode())


def say(document):
    line = document if isinstance(document, bytes) else json.dumps(document).encode() + b"\n"
    while line:
        line = line[os.write(replies, line) :]


def die(number):
    os.kill(os.getpid(), number)
    time.sleep(60)


def utc():
    now = time.time()
    fraction = f"{now % 1:.6f}"[1:]
    return time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(now)) + (fraction if fraction != ".000000" else "") + "+00:00"


def good(request):
    token = int.from_bytes(os.urandom(4), "big")
    results = [
        {
            "conductor": c,
            "validity": "good",
            "estimates": {stem: estimate(token, c, stem) for stem in ("sag", "clearance")},
            "frames_used": 1,
            "landmarks_used": token,
            "method": "stand-in",
        }
        for c in conductors
    ]
    more = {"overlays": pictures(request["overlay_dir"])} if request.get("overlay_dir") else {}
    return token, {
        **more,
        "kind": "reply",
        "id": request["id"],
        "acquired_at": utc(),
        "monotonic_s": time.monotonic(),
        "camera": "stand-in",
        "results": results,
        "elapsed_s": 0.0,
        "memory_mb": 20.0,
    }


def pictures(directory):
    """As large as real ones, written as the real worker writes them."""
    written = {}
    for conductor in conductors:
        path = f"{directory}/{conductor}.jpg"
        try:
            with open(path + ".part", "wb") as stream:  # noqa: PTH123 - pathlib takes longer to import
                stream.write(b"\xff\xd8" + bytes(300_000))
            os.replace(path + ".part", path)  # noqa: PTH105
            written[conductor] = path
        except OSError:
            note("N " + conductor)
    return written


def fault(cause, detail, text, request, **more):
    reason = {"cause": cause, "detail_qual": detail, "text": text}
    say({"kind": "fault", "id": request["id"], "reason": reason, **more})


SIGNALS = {"kill": 9, "segfault": 11, "abort": 6, "terminate": 15}
FAULTS = {
    "camera-fault": ("camera-fault", "failure", "no frame in 5 s"),
    "night": ("dark", "failure", "median grey 3 of 255"),
    "stale": ("stale-frame", "oldData", "the same frame again, bit for bit"),
}


def misbehave(kind, request):
    """Do the wrong thing; returns when the worker is meant to live on."""
    token, reply = good(request)
    if kind in SIGNALS:
        die(SIGNALS[kind])
    elif kind in FAULTS:
        fault(*FAULTS[kind], request)
    elif not (
        perish(kind, token, reply, request)
        or babble(kind, token, reply)
        or tell_in_part(kind, token, reply)
        or tell_all_oddly(kind, token, reply)
    ):
        raise SystemExit(f"unknown kind {kind}")


def perish(kind, token, reply, request):
    """End, or never go on; returns whether this kind is one of those."""
    if kind == "exit":
        sys.exit(3)
    elif kind == "hang":
        time.sleep(60)
    elif kind == "stop":  # like SIGSTOP from a debugger, or a process in the driver's state D
        os.kill(os.getpid(), 19)
    elif kind == "hang-with-child":
        if os.fork() == 0:
            time.sleep(60)
        time.sleep(60)
    elif kind == "half-line":
        say(json.dumps(reply).encode()[: 20 + token % 200])
        sys.exit(0)
    elif kind == "memory-blow-up":
        blow_up(request)
    elif kind == "fatal":
        fault("bad-calibration", "badReference", "the calibration cannot be read", request, fatal=True)
        sys.exit(70)
    else:
        return False
    return True


def babble(kind, token, reply):
    """A line that is no reply to what was asked, or holds what is no number; returns whether this kind is one."""
    first = reply["results"][0]
    if kind == "garbage":
        say(os.urandom(200).replace(b"\n", b"") + b"\n")
    elif kind == "flipped-bits":
        line = bytearray(json.dumps(reply).encode())
        line[1] ^= 0x40  # never again JSON, whatever else flips
        for _ in range(3):
            line[int.from_bytes(os.urandom(2), "big") % len(line)] ^= 1 << (token % 7)
        say(bytes(line).replace(b"\n", b" ") + b"\n")
    elif kind == "long-line":
        say(b"x" * 1_200_000)
    elif kind == "second-hello":
        say({"kind": "hello", "pid": os.getpid(), "camera": "x", "calibration_id": "x"})
    elif kind in {"wrong-id", "old-reply"}:
        reply["id"] += 1 + token % 9 if kind == "wrong-id" else -1
        say(reply)
    elif kind in {"not-a-number", "infinite"}:
        first["estimates"]["sag"][token % 4] = float("nan" if kind == "not-a-number" else "inf")
        say(reply)
    else:
        return False
    return True


def tell_in_part(kind, token, reply):
    """A reply of which one conductor's numbers may not be told; returns whether this kind is one."""
    first = reply["results"][0]
    if kind == "interval-inside-out":
        first["estimates"]["sag"][2:] = first["estimates"]["sag"][:1:-1]
    elif kind == "negative-uncertainty":
        first["estimates"]["clearance"][1] *= -1
    elif kind == "numbers-with-invalid":
        first["validity"] = "invalid"
        first["reasons"] = [{"cause": "dark", "detail_qual": "failure", "text": "night"}]
    elif kind == "without-sag":
        del first["estimates"]["sag"]
    elif kind == "conductor-missing":
        reply["results"] = reply["results"][1:]
    elif kind == "conductor-unknown":
        first["conductor"] = "nobody"
    else:
        return False
    note(f"P {token}")
    say(reply)
    return True


def tell_all_oddly(kind, token, reply):
    """A good reply that comes with something else wrong; returns whether this kind is one."""
    if kind == "leak":
        reply["memory_mb"] = 5000.0
    elif kind == "slow":
        time.sleep(0.2)
    elif kind == "noisy":
        os.write(1, b"noise on standard output " * 4000)
    else:
        return False
    note(f"G {token}")
    say(reply)
    return True


def blow_up(request):
    """Takes memory until the kernel refuses, as the real worker under its limit, and says so as that one does."""
    import resource

    with open("/proc/self/statm") as statm:  # noqa: PTH123 - pathlib takes longer to import than this worker lives
        mapped = int(statm.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + 64_000_000, mapped + 64_000_000))
    hoard = []
    try:
        while True:
            hoard.append(bytes(1_000_000))
    except MemoryError:
        hoard.clear()
        fault("worker-crashed", "failure", "more memory than worker.memory_max_mb", request, fatal=True)
        sys.exit(70)


say({"kind": "hello", "pid": os.getpid(), "camera": "stand-in", "calibration_id": "coded"})
turn = int.from_bytes(os.urandom(2), "big")
faulty = False
for line in requests:
    asked = json.loads(line)
    if (faulty or always) and kinds:
        turn += 1
        which = kinds[turn % len(kinds)]
        note(f"F {which}")
        misbehave(which, asked)
    else:
        code, answer = good(asked)
        note(f"G {code}")
        say(answer)
    faulty = not faulty
