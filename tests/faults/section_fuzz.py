"""Files, lines and pictures that somebody, or a worn card, has mutilated: each is read or refused with a sentence.

A plain mutational fuzzer: real inputs, in which bytes flip, pieces vanish, repeat or change places, and numbers and
words become nasty ones. Whatever is raised must be one of the program's own errors; nothing may take long.
"""

import contextlib
import json
import logging
import os
import re
import shutil
import tempfile
import time
import tomllib
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
from pydantic import TypeAdapter, ValidationError
from rig import SITE
from section_backlog import coded_reading
from table import Line

from sagnode.calibrate.files import load_intrinsics
from sagnode.capture.images import decode_grey
from sagnode.config.load import examine
from sagnode.daemon.ladder import Ladder, Steps
from sagnode.daemon.sequence import Ceiling
from sagnode.daemon.spool import Spool
from sagnode.daemon.stamp import Stamp
from sagnode.errors import SagnodeError
from sagnode.message import Identity
from sagnode.worker.protocol import MeasureReply, WorkerLine

COUNTS = {"node file": 8_000, "span file": 10_000, "calibration file": 20_000, "picture": 25_000,
          "worker's line": 40_000, "spool, count and memory files": 6_000}  # fmt: skip
SLOW_S = 10.0
"""Of the processor's time."""
_NASTY = (
    b"-1", b"0", b"1e999", b"-1e308", b"nan", b"inf", b"9" * 400, b"0x7fffffff", b"true", b"''", b'""', b"[]", b"{}",
    b"null", b"\x00", b"\xff\xfe", b"\xed\xa0\x80", b"{" * 50, b"[" * 2000, b"%s%n", b"../../etc/passwd", b"/dev/zero",
    b"{unit.__class__}", b"{0}", b"\n", b"=", b"#", b'"', b"1979-05-27", b"2026-02-30T25:61:61Z", b"/", b"..",
)  # fmt: skip
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:e-?\d+)?")


def mutated(random, data):
    """A copy with a few things wrong."""
    data = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 3, 8))):
        at = random.randrange(len(data) + 1)
        length = random.choice((1, 1, 2, 8, 40, 200))
        how = random.randrange(8)
        if how == 0 and data:
            data[at % len(data)] ^= 1 << random.randrange(8)
        elif how == 1:
            del data[at : at + length]
        elif how == 2:
            data[at:at] = data[at : at + length] * random.choice((1, 1, 2, 30))
        elif how == 3:
            data[at:at] = random.choice(_NASTY)
        elif how == 4:
            data[at : at + length] = random.randbytes(length)
        elif how == 5:
            del data[at:]
        elif numbers := list(_NUMBER.finditer(data)):
            number = random.choice(numbers)
            data[number.start() : number.end()] = random.choice(_NASTY)
    return bytes(data)


def run(campaign):
    logging.getLogger("sagnode").setLevel(logging.CRITICAL + 1)  # every refusal is a line
    with tempfile.TemporaryDirectory() as scratch:
        place = Path(scratch)
        for name in ("span.toml", "camera.yaml", "reference.jpg", "node.toml"):
            shutil.copy(SITE / name, place)
        for title, target in targets(campaign, place).items():
            times = campaign.count(COUNTS[title])
            began, slowest, uncaught = time.monotonic(), 0.0, {}
            for _ in range(times):
                at = time.process_time()
                try:
                    target()
                except SagnodeError as error:
                    str(error)
                except Exception as error:  # noqa: BLE001 - what this is about
                    uncaught.setdefault(f"{type(error).__name__}: {error}"[:200], 0)
                    uncaught[f"{type(error).__name__}: {error}"[:200]] += 1
                slowest = max(slowest, time.process_time() - at)
            broken = [f"{count} times {text}" for text, count in uncaught.items()]
            if slowest > SLOW_S:
                broken.append(f"one took {slowest:.0f} s")
            rate = times / (time.monotonic() - began)
            yield Line("fuzz", f"mutilated {title}", times, broken=broken,
                       remark=f"{sum(uncaught.values())} uncaught, {rate:.0f}/s, slowest {slowest:.1f} s")  # fmt: skip


def targets(campaign, place):
    random = campaign.random
    template = Path(str(SITE)).parents[1] / "config" / "templates" / "node.toml"
    nodes = [(place / "node.toml").read_bytes(), uncommented(template.read_bytes())]
    span = (place / "span.toml").read_bytes()
    cameras = [(place / "camera.yaml").read_bytes(), *other_calibrations(place)]
    pictures = [bytes(picture) for picture in some_pictures()]
    lines = [json.dumps(reply()).encode(), b'{"kind":"hello","pid":7,"camera":"c","calibration_id":"x"}']
    adapter = TypeAdapter(WorkerLine)
    stamp = Stamp(
        Identity(utility="u", line="l", span="s", unit="n"), {"L1": "a", "L2": None}, "m", "c", "0", "b", False
    )
    spool = Spool(place / "spool")
    spool.keep([coded_reading(1, reading_time())])
    kept = (place / "spool").read_bytes()

    def node_file():
        (place / "node.toml").write_bytes(mutated(random, random.choice(nodes)))
        (place / "span.toml").write_bytes(span)
        for fault in examine(place / "node.toml").faults:
            str(fault)

    def span_file():
        (place / "span.toml").write_bytes(mutated(random, span))
        for fault in examine(place / "span.toml").faults:
            str(fault)

    def calibration():
        path = place / random.choice(("c.yaml", "c.json", "c.xml"))
        path.write_bytes(mutated(random, random.choice(cameras)))
        load_intrinsics(path)

    def picture():
        with muted():
            decode_grey(mutated(random, random.choice(pictures)), "picture")

    def workers_line():
        with contextlib.suppress(ValidationError):  # as the supervisor, which makes it a reason
            answer = adapter.validate_json(mutated(random, random.choice(lines)))
            if isinstance(answer, MeasureReply):
                for reading in stamp.reply(answer, clock_synced=True, calibration_id="c"):
                    reading.model_dump_json()

    def small_files():
        (place / "spool").write_bytes(mutated(random, kept))
        for burst in spool.load():
            assert burst[0].landmarks_used == 1
        (place / "recovery.json").write_bytes(mutated(random, b'{"boot_id": "b", "restarts": 1, "reboots": 2}'))
        Ladder(place / "recovery.json", Steps(1, 1, False, 1), "b").answered()
        (place / "sequence").write_bytes(mutated(random, b"41000\n"))
        assert Ceiling(place / "sequence").value >= 0

    return dict(zip(COUNTS, (node_file, span_file, calibration, picture, workers_line, small_files), strict=True))


def uncommented(template):
    """The template with everything switched on that stays TOML: all keys are met."""
    lines = []
    for line in template.decode().splitlines():
        opened = line.removeprefix("# ") if re.match(r"# (\[|\w+ = )", line) else line
        with contextlib.suppress(tomllib.TOMLDecodeError):
            tomllib.loads("\n".join([*lines, opened]))
            lines.append(opened)
    return "\n".join(lines).encode()


def other_calibrations(place):
    """The same as JSON and XML of OpenCV."""
    intrinsics = load_intrinsics(place / "camera.yaml")
    matrix = np.array([[intrinsics.fx, 0, intrinsics.cx], [0, intrinsics.fy, intrinsics.cy], [0, 0, 1]])
    for kind in ("json", "xml"):
        path = place / f"other.{kind}"
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", intrinsics.width)
        storage.write("image_height", intrinsics.height)
        storage.write("camera_matrix", matrix)
        storage.write("distortion_coefficients", np.array([[0.01, 0.0, 0.0, 0.0, 0.0]]))
        storage.release()
        yield path.read_bytes()


def some_pictures():
    gradient = np.add.outer(np.arange(48), np.arange(64)).astype(np.uint8)
    for kind in (".jpg", ".png", ".pgm", ".tiff"):
        yield cv2.imencode(kind, gradient)[1]
    yield cv2.imencode(".png", gradient.astype(np.uint16) * 500)[1]


@contextlib.contextmanager
def muted():
    """What the decoders say on standard error is thrown away."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def reply():
    result = {
        "conductor": "L1", "validity": "good", "estimates": {"sag": [8.0, 0.01, 7.98, 8.02]}, "frames_used": 1,
        "method": "m", "visible_share": 0.9, "match_score": 7.0, "pose_residual_px": 0.3, "landmarks_used": 5,
        "reasons": [{"cause": "dark", "detail_qual": "failure", "text": "night"}], "budget": {"sag": {"pose": 0.01}},
    }  # fmt: skip
    return {
        "kind": "reply", "id": 1, "acquired_at": "2026-06-01T00:00:00+00:00", "monotonic_s": 5.5, "camera": "c",
        "results": [result, {**result, "conductor": "L2"}], "elapsed_s": 0.1, "memory_mb": 50.0,
    }  # fmt: skip


def reading_time():
    return datetime(2026, 6, 1, tzinfo=UTC)
