"""Brokers and links that fail in every way; readings go on meanwhile, and nothing of them is lost."""

import signal
import time
from functools import partial

from rig import Rig
from table import Line

MODES = {
    "refuse": "broker refuses connections",
    "closed": "nobody listens",
    "silent": "link takes everything and delivers nothing",
    "mute-broker": "PUBACKs do not come through",
    "slow": "link of 20 kB/s",
}
CUTS = ("before-puback", "inside-puback", "inside-publish", "after-publish")
ON_THE_WIRE = 20
"""As configured by the rig: so many readings can have lost their PUBACK with one link."""


def run(campaign):
    works = [partial(cut, where=where, each=campaign.count(40)) for where in CUTS]
    works += [partial(broken_link, mode=mode, title=title, each=campaign.count(10)) for mode, title in MODES.items()]
    works += [partial(killed, times=campaign.count(20), store=store) for store in (False, True)]
    works += [partial(stopped, times=campaign.count(15)), patient, name_not_found]
    return campaign.side_by_side(*works, at_once=4)


def rig_of(campaign, *broker_lines, **options):
    more = {"virtual": False, "interval_s": 0.1, "broker_lines": broker_lines}
    return Rig(campaign.fresh("broker"), **{**more, **options})


def acknowledged_since(rig, instant, seconds=70.0):
    """Seconds until the broker acknowledges a reading again."""
    at = rig.wait_for(lambda: rig.witness.first_acknowledged_after(instant), seconds)
    return at - instant


def cut(campaign, where, each):
    with rig_of(campaign) as rig:
        rig.start()
        acknowledged_since(rig, time.monotonic())
        recovery = []
        while rig.witness.cuts < each:
            before = rig.witness.cuts
            rig.witness.cut(where)
            rig.wait_for(lambda n=before: rig.witness.cuts > n, 60)
            recovery.append(acknowledged_since(rig, time.monotonic()))
            time.sleep(campaign.random.uniform(0.05, 0.3))
        rig.last_run()
        return Line.of("broker", f"link reset {where.replace('-', ' ')}", each, rig.books(), recovery=recovery,
                       limit_s=60.0, allowed_repeats=each * ON_THE_WIRE)  # fmt: skip


def broken_link(campaign, mode, title, each):
    with rig_of(campaign, sets={"daemon.session.PUBACK_WAIT_S": 1.0, "daemon.link.BACKOFF_MAX_S": 1.0}) as rig:
        rig.start()
        acknowledged_since(rig, time.monotonic())
        recovery = []
        for _ in range(each):
            rig.witness.mode = mode
            time.sleep(campaign.random.uniform(0.2, 2.0))
            rig.witness.mode = "pass"
            recovery.append(acknowledged_since(rig, time.monotonic()))
        rig.last_run()
        return Line.of("broker", title, each, rig.books(), recovery=recovery, limit_s=60.0,
                       allowed_repeats=each * 3 * ON_THE_WIRE)  # fmt: skip


def stopped(campaign, times):
    with rig_of(campaign, sets={"daemon.session.PUBACK_WAIT_S": 1.0, "daemon.link.BACKOFF_MAX_S": 1.0}) as rig:
        rig.start()
        acknowledged_since(rig, time.monotonic())
        recovery = []
        for _ in range(times):
            rig.broker.signal(signal.SIGSTOP)
            time.sleep(campaign.random.uniform(0.5, 3.0))
            rig.broker.signal(signal.SIGCONT)
            recovery.append(acknowledged_since(rig, time.monotonic()))
        rig.last_run()
        return Line.of("broker", "broker stopped (SIGSTOP) and continued", times, rig.books(), recovery=recovery,
                       limit_s=60.0, allowed_repeats=times * 3 * ON_THE_WIRE)  # fmt: skip


def killed(campaign, times, *, store):
    lines = ()
    directory = campaign.fresh("broker")
    if store:
        lines = ("persistence true", f"persistence_location {directory}/", "autosave_on_changes true",
                 "autosave_interval 1")  # fmt: skip
    with rig_of(campaign, *lines) as rig:
        rig.start()
        acknowledged_since(rig, time.monotonic())
        recovery = []
        for _ in range(times):
            time.sleep(campaign.random.uniform(0.1, 0.6))
            rig.broker.kill()
            time.sleep(campaign.random.uniform(0, 0.6))
            rig.broker.start()
            recovery.append(acknowledged_since(rig, time.monotonic()))
        rig.wait_for(rig.subscriber.subscribed.is_set, 30)
        rig.last_run()
        # what the broker acknowledged and forgot is the broker's: delivered is what it acknowledged
        kept = "with its store" if store else "without a store"
        return Line.of("broker", f"broker killed and restarted {kept}", times, rig.books(by_witness=True),
                       recovery=recovery, limit_s=60.0, allowed_repeats=times * ON_THE_WIRE)  # fmt: skip


def patient(campaign):
    """With the shipped patience: a broker that is away for longer than the longest pause between two attempts."""
    recovery = []
    with rig_of(campaign, sets={"daemon.link.BACKOFF_MAX_S": 30.0}) as rig:
        rig.start()
        acknowledged_since(rig, time.monotonic())
        rig.broker.kill()
        time.sleep(campaign.seconds(40.0))
        rig.broker.start()
        recovery.append(acknowledged_since(rig, time.monotonic()))
        rig.wait_for(rig.subscriber.subscribed.is_set, 30)
        rig.last_run()
        return Line.of("broker", "broker away for 40 s, with the shipped back-off", 1, rig.books(by_witness=True),
                       recovery=recovery, limit_s=60.0, allowed_repeats=ON_THE_WIRE)  # fmt: skip


def name_not_found(campaign):
    """The name server is not there at boot; after that the name is found."""
    with rig_of(campaign, names=True) as rig:
        rig.start()
        rig.wait_for(lambda: (p := rig.page()) and "name not found" in p["health"]["broker"], 30)
        time.sleep(1)
        (rig.directory / "names").write_text("found")
        recovery = [acknowledged_since(rig, time.monotonic())]
        rig.last_run()
        return Line.of("broker", "no name server at boot", 1, rig.books(), recovery=recovery, limit_s=60.0)
