"""One node under test: the real daemon, a real broker behind the witness, a real subscriber, and the books of all."""

import contextlib
import json
import os
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from brokers import Mosquitto, Subscriber
from coded import is_true
from nodes import write_node
from witness import Witness

HERE = Path(__file__).parent
CONDUCTORS = ("L1", "L2", "L3")


@dataclass
class Books:
    """What became of everything that was made, in one section of the campaign."""

    made: int = 0
    """Readings that the journal ever numbered."""
    delivered: int = 0
    lost: int = 0
    repeated: int = 0
    false: int = 0
    in_flight: int = 0
    """Answers of a worker that were not committed yet when the daemon was killed."""
    gaps: int = 0
    """Numbers that were skipped on purpose, because nobody could know whether they had been used."""
    remarks: list = field(default_factory=list)

    def add(self, other):
        for name in ("made", "delivered", "lost", "repeated", "false", "in_flight", "gaps"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.remarks += other.remarks


class Manager:
    """Listens as systemd does: READY, STATUS, WATCHDOG."""

    def __init__(self, path):
        self.heard = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(path))
        self._socket.settimeout(0.2)
        self._over = False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self):
        while not self._over:
            with contextlib.suppress(TimeoutError):
                text = self._socket.recv(65536).decode()
                self.heard += [(time.monotonic(), line) for line in text.splitlines()]

    def last(self, word):
        return max((at for at, line in list(self.heard) if line.startswith(word)), default=None)

    def close(self):
        self._over = True
        self._thread.join()
        self._socket.close()


class Rig:
    """Put together in a directory of its own; a context manager that leaves no process behind.

    Args:
        directory: its own.
        kinds: faults of the stand-in worker, by turns; none: it is always well.
        virtual: time jumps to the next slot, so that readings follow each other as fast as they are made.
        direct: the node speaks to the broker without the witness in between.
    """

    def __init__(self, directory, kinds=(), *, virtual=True, direct=False, worker=None, sets=None, clock=False,
                 interval_s=0.1, deadline_s=5.0, more="", mqtt="", state_dir=None, span=None, broker_lines=(),
                 runtime=False, manager=False, camera=None, names=False, always=False, pictures=False):  # fmt: skip
        self.directory = directory
        directory.mkdir(parents=True, exist_ok=True)
        self.state = Path(state_dir) if state_dir else directory / "state"
        self.runtime = directory / "run" if runtime else None
        if self.runtime:
            self.runtime.mkdir(exist_ok=True)
        self.ledger = directory / "ledger"
        self.ledger.touch()
        self.clock = directory / "clock"
        self.clock.write_text("0")
        self.broker = Mosquitto(directory, "max_inflight_messages 200", "max_queued_messages 200000", *broker_lines)
        self.direct = direct
        self._options = {
            "virtual": virtual, "interval_s": interval_s, "deadline_s": deadline_s, "more": more, "mqtt": mqtt,
            "camera": camera, "pictures": pictures, "host": "127.0.0.1",
        }  # fmt: skip
        self._words = {
            "worker": worker
            or [sys.executable, "-S", "-E", str(HERE / "fast_worker.py"), "{requests}", "{replies}", str(self.ledger),
                ",".join(CONDUCTORS), *(["always"] if always else []), *kinds],
            "set": {"daemon.link.BACKOFF_MAX_S": 1.0, **(sets or {})},
            **({"clock": str(self.clock)} if clock else {}),
            **({"names": str(directory / "names")} if names else {}),
        }  # fmt: skip
        self.daemon = None
        self.launch = self._launch
        """Starts the daemon's words with an environment; another machine can do that too."""
        self.kills = 0
        self.peak_mb = 0.0
        """Greatest memory of a daemon that was ended."""
        self.witness = self.subscriber = None
        self.manager = Manager(directory / "notify") if manager else None
        self._log = (directory / "log").open("ab")

    # -- life

    def __enter__(self):
        self.broker.start()
        self.witness = Witness(self.broker.port)
        self.subscriber = Subscriber(self.broker.port, "sagnode/#").__enter__()
        self.configure()
        return self

    def __exit__(self, *_):
        if self.daemon is not None:
            self.kill()
        self.subscriber.__exit__()
        self.witness.close()
        self.broker.__exit__()
        if self.manager:
            self.manager.close()
        self._log.close()

    def configure(self, **changes):
        """Write the node's and the span's file anew."""
        o = {**self._options, **changes}
        camera = o["camera"] or (
            'backend = "replay"\n[camera.replay]\npath = "frames"' if o["virtual"] else 'backend = "v4l2"'
        )
        port = self.broker.port if self.direct else self.witness.port
        clock = "virtual" if o["virtual"] else "system"
        write_node(
            self.directory,
            camera,
            f'interval_s = {o["interval_s"]}\ndeadline_s = {o["deadline_s"]}\nclock = "{clock}"',
            state=self.state,
            backoff_max_s=0.2,
            more=f"""pictures = {str(o["pictures"]).lower()}
{o["more"]}
[mqtt]
host = "{o["host"]}"
port = {port}
backlog_per_s = 2000.0
inflight = 20
{o["mqtt"]}""",
        )

    def start(self, **environment):
        env = {k: v for k, v in os.environ.items() if k not in {"STATE_DIRECTORY", "RUNTIME_DIRECTORY"}}
        if self.runtime:
            env["RUNTIME_DIRECTORY"] = str(self.runtime)
        if self.manager:
            env["NOTIFY_SOCKET"] = str(self.directory / "notify")
        words = [sys.executable, str(HERE / "stand_in_node.py"), str(self.directory / "node.toml")]
        self.daemon = self.launch([*words, json.dumps(self._words)], {**env, **environment})
        return self.daemon

    def _launch(self, words, environment):
        return subprocess.Popen(words, stdout=self._log, stderr=self._log, env=environment)

    def kill(self):
        """``kill -9`` of the daemon."""
        self.kills += 1
        self._weigh()
        self.daemon.kill()
        self.daemon.wait()
        self.daemon = None

    def stop(self, seconds=15.0):
        """An orderly end; returns how long it took."""
        began = time.monotonic()
        self._weigh()
        self.daemon.send_signal(signal.SIGTERM)
        try:
            code = self.daemon.wait(seconds)
        except subprocess.TimeoutExpired:
            self.daemon.send_signal(signal.SIGABRT)  # its fault handler writes where every thread stands
            code = self.daemon.wait()
            raise AssertionError(f"did not stop in {seconds} s: {self.log()[-4000:]}") from None
        self.daemon = None
        assert code == 0, f"exit code {code}: {self.log()[-2000:]}"
        return time.monotonic() - began

    def _weigh(self):
        with contextlib.suppress(OSError):
            for line in Path(f"/proc/{self.daemon.pid}/status").read_text().splitlines():
                if line.startswith("VmHWM:"):
                    self.peak_mb = max(self.peak_mb, int(line.split()[1]) / 1000)

    def worker_pids(self):
        found = []
        for path in Path("/proc").glob("[0-9]*/cmdline"):
            with contextlib.suppress(OSError):
                words = path.read_bytes()
                if str(self.ledger).encode() in words and b"stand_in_node" not in words:
                    found.append(int(path.parent.name))
        return found

    # -- looking

    def log(self):
        return (self.directory / "log").read_text(errors="replace")

    def page(self):
        for place in (self.runtime, self.state):
            if place is not None:
                with contextlib.suppress(OSError, ValueError):
                    return json.loads((place / "status.json").read_text())
        return None

    def entries(self, tail=None):
        """The ledger, or so many bytes at its end: (monotonic seconds, G, P or F, token or kind)."""
        found = []
        with self.ledger.open() as stream:
            if tail is not None:
                stream.seek(max(0, self.ledger.stat().st_size - tail))
                stream.readline()
            text = stream.read()
        for line in text.splitlines():
            at, what, word = line.split(" ")
            found.append((float(at), what, word))
        return found

    def good(self):
        return sum(1 for _, what, _ in self.entries() if what == "G")

    def wait_for(self, condition, seconds=30.0, every=0.01):
        until = time.monotonic() + seconds
        while not (value := condition()):
            assert time.monotonic() < until, f"not in {seconds} s; {self.log()[-1500:]}"
            time.sleep(every)
        return value

    def wait_good(self, more, seconds=60.0):
        """Until the worker has given so many good answers more."""
        goal = self.good() + more
        self.wait_for(lambda: self.good() >= goal, seconds, 0.02)

    def rows(self, journal=None):
        """The journal: sequence to (json, fate)."""
        with contextlib.closing(sqlite3.connect(journal or self.state / "journal.sqlite", timeout=10)) as db:
            query = "SELECT sequence, json, fate FROM readings ORDER BY sequence"
            return {sequence: (json.loads(text), fate) for sequence, text, fate in db.execute(query)}

    def pending(self):
        with contextlib.closing(sqlite3.connect(self.state / "journal.sqlite", timeout=10)) as db:
            return db.execute("SELECT count(*) FROM readings WHERE fate = 'pending'").fetchone()[0]

    def drain(self, seconds=90.0):
        """Until nothing is owed any more; the stand-in goes on meanwhile, so the daemon is stopped first if it runs."""
        self.wait_for(lambda: self.pending() <= 2 * len(CONDUCTORS), seconds, 0.05)

    def last_run(self, seconds=90.0):
        """A last, undisturbed run without new readings: everything owed goes out, then the daemon is stopped."""
        if self.daemon is not None:
            self.stop()
        worker, self._words["worker"] = self._words["worker"], ["/bin/sleep", "1000"]
        self.witness.mode, self.witness._cut = "pass", None
        self.configure(virtual=False, interval_s=3600)
        self.start()
        self.wait_for(lambda: (page := self.page()) and page["pid"] == self.daemon.pid, seconds, 0.05)
        self.wait_for(lambda: self.pending() == 0, seconds, 0.05)
        self.stop()
        self._words["worker"] = worker
        self.configure()

    def books(self, *, by_witness=False, allowed_gaps=False, coded=True):
        """Compare worker's ledger, journal, witness and subscriber.

        Args:
            by_witness: count as delivered what the broker acknowledged, for a broker that forgets what it acknowledged.
            allowed_gaps: damage was done to the journal, so numbers may be skipped.
            coded: the readings carry the stand-in's tokens.
        """
        rows = self.rows()
        time.sleep(0.3)
        received = self.subscriber.readings()
        heard = {}
        for reading in received:
            heard.setdefault(reading["sequence"], []).append(reading)
        books = Books(made=len(rows))
        arrived = set(heard) | (self.witness.acknowledged() if by_witness else set())
        lost = [sequence for sequence in rows if sequence not in arrived]
        # Numbers may have leapt by millions of millions: the missing ones are counted, never listed.
        missing = max(rows, default=0) - len(rows)
        if allowed_gaps:
            books.gaps = missing
            lost += [n for n in self.witness.sent if n not in rows]
        books.delivered = sum(1 for sequence in rows if sequence in arrived)
        books.lost = len(lost) + (0 if allowed_gaps else missing)
        if missing and not allowed_gaps:
            after = next(n for n in (0, *rows) if n + 1 not in rows)
            books.remarks.append(f"{missing} numbers are missing in the journal, the first of them {after + 1}")
        books.repeated = sum(len(copies) - 1 for copies in heard.values())
        tokens = {int(word) for _, what, word in self.entries() if what in "GP"}
        recorded = {r["landmarks_used"] for r, _ in rows.values() if r["quality"]["validity"] != "invalid"}
        for sequence, copies in heard.items():
            if any(not self.is_true(copy) for copy in copies):
                books.false += 1
                books.remarks.append(f"reading {sequence} is not what was measured")
            if any({**c, "published_at": 0, "backfill": 0} != {**copies[0], "published_at": 0, "backfill": 0}
                   for c in copies):  # fmt: skip
                books.false += 1
                books.remarks.append(f"reading {sequence} has two contents")
        books.false += len(recorded - tokens) if coded else 0
        books.false += sum(1 for r, _ in rows.values() if not self.is_true(r))
        sound = {int(word) for _, what, word in self.entries() if what == "G"}
        books.in_flight = len(sound - recorded) if coded else 0
        if lost:
            books.remarks.append(f"lost: {sorted(lost)[:10]}")
        return books

    is_true = staticmethod(is_true)

    def recoveries(self):
        """Seconds from each fault of the worker to its next good answer."""
        waits, since = [], None
        for at, what, _ in self.entries():
            if what == "F" and since is None:
                since = at
            elif what == "G" and since is not None:
                waits.append(at - since)
                since = None
        return waits
