"""What is fuzzed: for each kind of input a function that mutilates one and has it read; true when it was refused."""

import argparse
import contextlib
import copy
import io
import json
import os
import re
import shutil
import sqlite3
import tomllib
from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
from mutate import mutated, rearranged
from nodes import SITE
from pydantic import TypeAdapter, ValidationError
from section_backlog import coded_reading

from sagnode.calibrate.files import load_intrinsics
from sagnode.capture.headers import DamagedError, read_header
from sagnode.capture.images import decode_grey
from sagnode.cli import fit, plan
from sagnode.config import load
from sagnode.config.document import Document, validate
from sagnode.config.node import Node
from sagnode.config.span import Span
from sagnode.daemon.alarms import Alarms, Debounce
from sagnode.daemon.commands import Inbox
from sagnode.daemon.dialogue import Dialogue
from sagnode.daemon.journal import Journal
from sagnode.daemon.journal_reader import Rows, Wanted
from sagnode.daemon.ladder import Ladder, Steps
from sagnode.daemon.outbox import Outbox
from sagnode.daemon.past import recent_readings
from sagnode.daemon.sequence import Ceiling
from sagnode.daemon.spool import Spool
from sagnode.daemon.stamp import Stamp
from sagnode.exchange import ReplyMessage
from sagnode.message import Identity
from sagnode.worker.protocol import MeasureReply, WorkerLine

COMMANDS = (
    b'{"command":"measure","correlation":"7"}',
    b'{"command":"picture","conductor":"L1"}',
    b'{"command":"resend","from_sequence":3,"to_sequence":9,"correlation":"a"}',
)
IDENTITY = Identity(utility="u", line="l", span="s", unit="n")
AT = datetime(2026, 6, 1, tzinfo=UTC)


def targets(campaign, place):
    """Title to function; each may use files below ``place``."""
    for name in ("span.toml", "camera.yaml", "reference.jpg", "node.toml"):
        shutil.copy(SITE / name, place)
    random = campaign.random
    return {
        **configuration(random, place),
        **calibration(random, place),
        **pictures(random),
        "worker's line": workers_line(random),
        "command": command(random, place),
        "journal row": journal_row(random, place),
        "spool, count and memory files": small_files(random, place),
        "clicks and numbers on the command line": words(random, place),
    }


def configuration(random, place):
    template = Path(str(SITE)).parents[1] / "config" / "templates" / "node.toml"
    nodes = [(place / "node.toml").read_bytes(), uncommented(template.read_bytes())]
    span = (place / "span.toml").read_bytes()
    (place / "fuzzed").mkdir()
    for name in ("camera.yaml", "reference.jpg"):
        shutil.copy(place / name, place / "fuzzed")

    def node_file():
        (place / "fuzzed" / "node.toml").write_bytes(mutated(random, random.choice(nodes)))
        (place / "fuzzed" / "span.toml").write_bytes(span)
        return [str(fault) for fault in load.examine(place / "fuzzed" / "node.toml").faults]

    def span_file():
        (place / "fuzzed" / "span.toml").write_bytes(mutated(random, span))
        return [str(fault) for fault in load.examine(place / "fuzzed" / "span.toml").faults]

    parsed_nodes = [tomllib.loads(text.decode()) for text in nodes]
    parsed_span = tomllib.loads(span.decode())

    def node_keys():
        document = Document(place / "node.toml", rearranged(random, random.choice(parsed_nodes)))
        validate(document, Node, load._node_contradictions)
        return [str(fault) for fault in document.faults]

    def span_keys():
        document = Document(place / "span.toml", rearranged(random, parsed_span))
        validate(document, Span, load.span_contradictions)
        return [str(fault) for fault in document.faults]

    return {"node file": node_file, "node file, key by key": node_keys,
            "span file": span_file, "span file, key by key": span_keys}  # fmt: skip


def uncommented(template):
    """The template with everything switched on that stays TOML: all keys are met."""
    lines = []
    for line in template.decode().splitlines():
        opened = line.removeprefix("# ") if re.match(r"# (\[|\w+ = )", line) else line
        with contextlib.suppress(tomllib.TOMLDecodeError):
            tomllib.loads("\n".join([*lines, opened]))
            lines.append(opened)
    return "\n".join(lines).encode()


def calibration(random, place):
    cameras = [(place / "camera.yaml").read_bytes(), *other_calibrations(place)]
    as_json = json.loads(cameras[1])

    def file():
        path = place / random.choice(("c.yaml", "c.json", "c.xml"))
        path.write_bytes(mutated(random, random.choice(cameras)))
        load_intrinsics(path)

    def keys():
        path = place / "keys.json"
        path.write_text(json.dumps(rearranged(random, as_json), default=str))
        load_intrinsics(path)

    return {"calibration file": file, "calibration file, key by key": keys}


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


def pictures(random):
    whole = [bytes(picture) for picture in some_pictures()]

    def picture():
        with muted():
            decode_grey(mutated(random, random.choice(whole)), "picture")

    def header():
        data = bytearray(random.choice(whole))
        for _ in range(random.choice((1, 2, 6))):  # where sizes, types and offsets are said
            at = random.randrange(min(len(data), 300))
            data[at : at + 4] = random.choice((bytes(4), b"\xff" * 4, b"\x7f\xff\xff\xff", random.randbytes(4)))
        with contextlib.suppress(DamagedError):
            read_header(bytes(data))
        with muted():
            decode_grey(bytes(data), "picture")

    return {"picture": picture, "picture's header": header}


def some_pictures():
    gradient = np.add.outer(np.arange(48), np.arange(64)).astype(np.uint8)
    for kind in (".jpg", ".png", ".pgm", ".tiff"):
        yield cv2.imencode(kind, gradient)[1]
    yield cv2.imencode(".png", gradient.astype(np.uint16) * 500)[1]
    yield cv2.imencode(".jpg", np.dstack([gradient] * 3), [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1]


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


def workers_line(random):
    document = reply()
    lines = [json.dumps(document).encode(), b'{"kind":"hello","pid":7,"camera":"c","calibration_id":"x"}']
    adapter = TypeAdapter(WorkerLine)
    stamp = Stamp(IDENTITY, {"L1": "a", "L2": None}, "m", "c", "0", "b", False)

    def line():
        if random.random() < 0.5:
            text = mutated(random, random.choice(lines))
        else:
            text = json.dumps(rearranged(random, document), default=str).encode()
        try:
            answer = adapter.validate_json(text)
        except ValidationError:  # as the supervisor, which makes it a reason
            return True
        if isinstance(answer, MeasureReply):
            for reading in stamp.reply(answer, clock_synced=True, calibration_id="c"):
                reading.model_dump_json()
        return False

    return line


def reply():
    result = {
        "conductor": "L1", "validity": "good", "estimates": {"sag": [8.0, 0.01, 7.98, 8.02]}, "frames_used": 1,
        "method": "m", "visible_share": 0.9, "match_score": 7.0, "pose_residual_px": 0.3, "landmarks_used": 5,
        "reasons": [{"cause": "dark", "detail_qual": "failure", "text": "night"}], "budget": {"sag": {"pose": 0.01}},
    }  # fmt: skip
    return {
        "kind": "reply", "id": 1, "acquired_at": "2026-06-01T00:00:00+00:00", "monotonic_s": 5.5, "camera": "c",
        "results": [result, {**copy.deepcopy(result), "conductor": "L2"}], "elapsed_s": 0.1, "memory_mb": 50.0,
    }  # fmt: skip


def command(random, place):
    """All the way through the dialogue: heard, carried out on a real journal, answered."""
    (place / "dialogue").mkdir()
    journal = Journal(place / "dialogue" / "journal.sqlite")
    journal.append([coded_reading(n, AT + timedelta(minutes=n)) for n in range(1, 31)], owed=True)
    seconds = iter(range(0, 2**60, 60))  # a minute passes between two commands
    inbox = Inbox(600, now=lambda: AT, monotonic=lambda: float(next(seconds)))
    replies = []
    inbox.answer_by(lambda topic, payload, **_: replies.append(payload))
    alarms = Alarms(IDENTITY, {}, Debounce(1, 1), file=place / "alarms.json", publish=lambda *_: None, test=False)
    dialogue = Dialogue(
        alarms, inbox, journal=journal, link=None, conductors=("L1", "L2"), picture_on_alarm=False
    )  # fmt: skip
    parsed = [json.loads(text) for text in COMMANDS]

    def one():
        replies.clear()
        if random.random() < 0.5:
            payload = mutated(random, random.choice(COMMANDS))
        else:
            payload = json.dumps(rearranged(random, random.choice(parsed)), default=str).encode()
        inbox.receive(payload, retained=False, correlation=random.choice((None, b"", random.randbytes(20))))
        if dialogue.wanted():
            dialogue.recorded([coded_reading(1, AT)], {}, AT)
        (answer,) = replies  # exactly one
        return not ReplyMessage.model_validate_json(answer).ok

    return one


def journal_row(random, place):
    """What a worn card makes of a row is set aside; what another version wrote is passed over."""
    (place / "journal").mkdir()
    journal = Journal(place / "journal" / "journal.sqlite")
    journal.append([coded_reading(n, AT + timedelta(minutes=n)) for n in range(1, 13)], owed=True)
    hand = sqlite3.connect(journal.path, isolation_level=None)
    hand.execute("PRAGMA synchronous = OFF")
    kept = hand.execute("SELECT sequence, acquired_at, conductor, validity, json, crc FROM readings").fetchall()
    columns = ("acquired_at", "conductor", "validity", "json", "crc", "fate")

    def row():
        outbox = Outbox(journal, inflight=20, backlog_per_s=1e6, expiry_s=1e9, now=lambda: AT)
        sequence, *values = random.choice(kept)
        column = random.choice(columns)
        value = random.choice(("pending", "delivered", "local")) if column == "fate" else values[columns.index(column)]
        strange = mutated(random, str(value).encode())
        with contextlib.suppress(sqlite3.IntegrityError):  # a fate that is none, no value at all
            as_what = random.choice((strange, strange.decode("latin-1"), random.randrange(2**62), None))
            hand.execute(f"UPDATE readings SET {column} = ? WHERE sequence = ?", (as_what, sequence))  # noqa: S608
        recent_readings(journal, 3)
        for outgoing in outbox.take():
            assert json.loads(outgoing.payload)["sequence"] == outgoing.sequence
        journal.find([coded_reading(1, AT)])
        shown = Rows(journal.path, Wanted())
        for stored in shown:
            assert stored.document["sequence"]
        set_aside = shown.damaged > 0
        hand.executemany(
            "REPLACE INTO readings VALUES (?, ?, ?, ?, ?, ?, 'pending', NULL)", [(sequence, *values)]
        )  # fmt: skip
        return set_aside

    return row


def small_files(random, place):
    spool = Spool(place / "spool")
    spool.keep([coded_reading(1, AT)])
    kept = (place / "spool").read_bytes()

    def files():
        (place / "spool").write_bytes(mutated(random, kept))
        bursts = spool.load()
        for burst in bursts:
            assert burst[0].landmarks_used == 1
        (place / "recovery.json").write_bytes(mutated(random, b'{"boot_id": "b", "restarts": 1, "reboots": 2}'))
        Ladder(place / "recovery.json", Steps(1, 1, False, 1), "b").answered()
        (place / "sequence").write_bytes(mutated(random, b"41000\n"))
        assert Ceiling(place / "sequence").value >= 0
        return not bursts

    return files


def words(random, place):
    """Clicks of ``sagnode fit``, places and numbers of ``sagnode plan``: mutilated words on the command line."""
    cv2.imwrite(str(place / "blank.png"), np.full((48, 64), 128, np.uint8))
    fit_words = [str(place / "blank.png"), "--from", "3,4", "--to", "60.5,4"]
    plan_words = ["--config", str(place), "--camera", "0.4,-1.5,21", "--noise", "2", "--grid", "1,2,3"]

    def line():
        command, given = random.choice(((fit, list(fit_words)), (plan, list(plan_words))))
        for _ in range(random.choice((1, 1, 2))):
            at = random.randrange(2, len(given))
            given[at] = os.fsdecode(mutated(random, os.fsencode(given[at]))).replace("\x00", "?")
        parser = argparse.ArgumentParser(allow_abbrev=False)
        command.add_arguments(parser)
        with muted(), contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            try:
                args = parser.parse_args(getattr(command, "arrange", list)(given))
                return command is fit and fit.run(args) != 0  # what plan then computes takes half a minute
            except SystemExit as end:
                assert end.code in {0, 2}, end.code
                return end.code != 0

    return line
