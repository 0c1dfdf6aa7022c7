"""The link was cut for a month: a hundred thousand readings wait, and a fresh one must not wait behind them."""

import json
import re
import time
from datetime import UTC, datetime, timedelta

from coded import estimate
from rig import CONDUCTORS, Rig
from table import Line

from sagnode.daemon.journal import Journal
from sagnode.message import Estimate, QualityMessage, Reading, estimate_fields
from sagnode.quality import Validity

BACKLOG = 100_000
RATE_PROMISED = 500.0
FRESH_PROMISED_S = 2.0
_SEQUENCE = re.compile(rb'"sequence":(\d+)')


def run(campaign):
    count = campaign.count(BACKLOG) // 300 * 300
    with Rig(campaign.fresh("backlog"), virtual=False, interval_s=1.0, direct=True) as rig:
        rig.state.mkdir()
        fill(rig.state / "journal.sqlite", count)
        arrivals = Arrivals(rig.subscriber, count)
        began = time.monotonic()
        rig.start()
        rig.wait_for(lambda: arrivals.backfill, 60)
        first = time.monotonic()
        rig.wait_for(lambda: arrivals.backfill >= count - len(CONDUCTORS), 60 + count / 100, 0.05)
        rate = arrivals.backfill / (time.monotonic() - first)
        rig.wait_good(2)
        rig.stop()
        time.sleep(0.5)
        rows = rig.rows()
        lost = [n for n in rows if n not in arrivals.seen]
        broken = []
        if rate < RATE_PROMISED and count > 10_000:
            broken.append(f"drained at {rate:.0f} a second, promised are {RATE_PROMISED:.0f}")
        if max(arrivals.fresh_s) > FRESH_PROMISED_S:
            broken.append(f"a fresh reading waited {max(arrivals.fresh_s):.1f} s")
        yield Line(
            "backlog", f"link cut for a simulated month ({count} readings)", 1, len(rows), len(rows) - len(lost),
            len(lost), arrivals.repeated, arrivals.false, recovery=[first - began], limit_s=60.0, broken=broken,
            remark=f"drained at {rate:.0f}/s; {len(arrivals.fresh_s)} fresh readings meanwhile, the slowest after"
            f" {max(arrivals.fresh_s):.2f} s",
        )  # fmt: skip


def fill(path, count):
    """A month of readings, each with numbers that say whether they are right."""
    journal = Journal(path)
    begin = datetime.now(UTC) - timedelta(days=31)
    step = timedelta(days=31) / count
    for start in range(0, count, 300):
        journal.append([coded_reading(start + i, begin + (start + i) * step) for i in range(300)], owed=True)
    journal.close()


def coded_reading(number, at):
    conductor = CONDUCTORS[number % len(CONDUCTORS)]
    estimates = {stem: Estimate(*estimate(number, conductor, stem)) for stem in ("sag", "clearance")}
    return Reading(
        utility="u", line="l", span="s", unit="n", conductor=conductor, sequence=1, acquired_at=at, clock_synced=True,
        boot_id="b", monotonic_s=1.0, quality=QualityMessage(validity=Validity.GOOD), frames_used=1, frames_rejected=0,
        landmarks_used=number, method="stand-in", calibration_id="coded", configuration_id="c", software_version="0",
        **estimate_fields(estimates),
    )  # fmt: skip


class Arrivals:
    """Counts what arrives without keeping it all."""

    def __init__(self, subscriber, old):
        self._old = old
        self.seen = set()
        self.backfill = self.repeated = self.false = 0
        self.fresh_s = []
        subscriber.client.on_message = self._arrived

    def _arrived(self, _client, _userdata, message):
        if "/measurement/" not in message.topic:
            return
        sequence = int(_SEQUENCE.search(message.payload)[1])
        self.repeated += sequence in self.seen
        self.seen.add(sequence)
        if b'"backfill":true' in message.payload:
            self.backfill += 1
            if sequence % 50:  # a sample: the machine is shared
                return
        reading = json.loads(message.payload)
        self.false += not Rig.is_true(reading)
        if sequence > self._old:
            age = datetime.now(UTC) - datetime.fromisoformat(reading["acquired_at"])
            self.fresh_s.append(age.total_seconds())
