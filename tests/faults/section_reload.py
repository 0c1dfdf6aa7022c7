"""Orders to read the configuration anew, good ones and bad ones; orders to stop; and the ladder of recovery."""

import itertools
import signal
import time
from functools import partial

from rig import Rig
from table import Line

from sagnode.daemon.node import STOP_DRAIN_S

PERIOD_S = 0.1
BAD = (
    ("[nonsense]\n", "a table that is unknown"),
    ("interval_s = ", "a file that is cut short"),
    ("\x00\xff", "a file that is no text"),
    ("[schedule]\ninterval_s = 0.1\n", "a table twice"),
)


def run(campaign):
    works = [
        partial(climbed, times=campaign.count(5)),
        partial(stopped, times=campaign.count(20)),
        partial(accepted, times=campaign.count(12)),
        partial(refused, times=campaign.count(100)),
    ]
    return campaign.side_by_side(*works, at_once=3)


def refused(campaign, times):
    """A bad configuration must not cost a single reading."""
    with Rig(campaign.fresh("reload"), virtual=False, interval_s=PERIOD_S) as rig:
        rig.start()
        rig.wait_good(3)
        node = rig.directory / "node.toml"
        whole = node.read_text()
        began, good_before = time.monotonic(), rig.good()
        for number in range(times):
            more, _ = BAD[number % len(BAD)]
            node.write_bytes((whole + more).encode("latin-1"))
            before = rig.log().count("reload refused")
            rig.daemon.send_signal(signal.SIGHUP)
            rig.wait_for(lambda n=before: rig.log().count("reload refused") > n, 60)
        elapsed, good = time.monotonic() - began, rig.good() - good_before
        page = rig.wait_for(lambda: (p := rig.page()) and p["health"]["configuration"] != "ok" and p)
        node.write_text(whole)
        gaps = longest_gap(rig, began)
        workers = rig.log().count("ready: stand-in")
        broken = []
        if workers != 1:
            broken.append(f"{workers} workers were needed")
        if "refused" not in page["health"]["configuration"]:
            broken.append("health does not tell")
        rig.last_run()
        return Line.of("reload", "reload of a bad configuration (refused)", times, rig.books(), recovery=[gaps],
                       broken=broken, limit_s=5.0, remark=f"{good} readings in {elapsed:.0f} s meanwhile")  # fmt: skip


def longest_gap(rig, since):
    """Greatest time between two good answers."""
    at = [t for t, what, _ in rig.entries() if what == "G" and t >= since]
    return max((b - a for a, b in itertools.pairwise(at)), default=0.0)


def accepted(campaign, times):
    with Rig(campaign.fresh("reload"), virtual=False, interval_s=PERIOD_S) as rig:
        rig.start()
        rig.wait_good(3)
        recovery = []
        for number in range(times):
            before = rig.log().count("read anew")
            rig.configure(deadline_s=5.0 + number + 1, interval_s=PERIOD_S, virtual=False)
            rig.daemon.send_signal(signal.SIGHUP)
            rig.wait_for(lambda n=before: rig.log().count("read anew") > n, 120)
            put_in_force = time.monotonic()
            rig.wait_good(1)
            recovery.append(time.monotonic() - put_in_force)
        rig.last_run()
        # what is on the wire when the link is taken down is owed again
        return Line.of("reload", "reload of a good configuration", times, rig.books(), recovery=recovery, limit_s=10.0,
                       allowed_repeats=times * 20)  # fmt: skip


def stopped(campaign, times):
    """SIGTERM at random moments: offline is said, nothing is owed for longer than needed, within five seconds."""
    took, starts = [], 0
    with Rig(campaign.fresh("reload"), virtual=False, interval_s=PERIOD_S) as rig:
        for _ in range(times):
            rig.start()
            starts += 1
            rig.wait_for(lambda: (p := rig.page()) and p["pid"] == rig.daemon.pid and p["broker_connected"], 60)
            time.sleep(campaign.random.uniform(0, 0.5))
            took.append(rig.stop())
        rig.last_run()
        time.sleep(0.3)
        states = [b'"state":"offline"' in m.payload for m in rig.subscriber.of("status")]
        broken = [] if states.count(True) == starts + 1 else [f"{starts + 1} stops, {states.count(True)} said offline"]
        return Line.of("reload", "stop (SIGTERM)", times, rig.books(), recovery=took, limit_s=5.0, broken=broken,
                       remark="recovery: time to stop",
                       allowed_repeats=20 * sum(seconds > STOP_DRAIN_S for seconds in took))  # fmt: skip


def climbed(campaign, times):
    """A camera that never comes back: the service ends twice, then the watchdog starves and a reboot is asked."""
    more = "[recovery]\nrestart_after_s = 0.5\nrestarts_before_reboot = 2\nreboot_wait_h = 0.0001\n"
    broken, took, rigs = [], [], []
    for _ in range(times):
        directory = campaign.fresh("reload")
        with Rig(directory, ("camera-fault", "hang"), virtual=False, interval_s=0.2, deadline_s=0.2, more=more,
                 runtime=True, manager=True, always=True) as rig:  # fmt: skip
            began = time.monotonic()
            codes = []
            for _ in range(2):
                rig.start(WATCHDOG_USEC="600000")
                codes.append(rig.daemon.wait(60))
            rig.start(WATCHDOG_USEC="600000")
            rig.wait_for(lambda rig=rig: (rig.runtime / "reboot-wanted").exists(), 60)
            took.append(time.monotonic() - began)
            asked = time.monotonic()
            time.sleep(1.5)
            if codes != [75, 75]:
                broken.append(f"exit codes {codes}")
            if rig.manager.last("WATCHDOG=1") > asked + 0.1:
                broken.append("the watchdog was still fed")
            rig.kill()
            rig._options["more"] = ""  # a patient ladder, while what is owed goes out
            rig.last_run()
            rigs.append(rig.books())
    total = rigs[0]
    for books in rigs[1:]:
        total.add(books)
    return Line.of("reload", "no reading any more: service restarted twice, then a reboot asked for", times, total,
                   recovery=took, broken=broken, remark="recovery: time to the request",
                   allowed_repeats=times * 3 * 20)  # fmt: skip
