"""Commands over MQTT, valid ones and mutilated ones, large, many, retained, sent to a running node that measures on.

Whatever arrives, the node goes on measuring with the same process, answers what is a command, and does nothing else.
"""

import itertools
import json
import time
from functools import partial

import paho.mqtt.client as mqtt
from fuzz_targets import COMMANDS
from mutate import mutated
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from rig import CONDUCTORS, Rig
from table import Line

from sagnode.exchange import COMMAND_MAX_BYTES, ReplyMessage

INPUTS = 6_000
PERIOD_S = 0.2
ROOT = "sagnode/v1/u/l/s/n"
ON_THE_WIRE = 20
"""As configured by the rig: so many readings can be on their way when the node is stopped on a busy machine."""
GAP_S = 10.0
"""Longest time between two readings, fifty periods; more would be a node that commands can stop."""


def run(campaign):
    works = [
        partial(mutilated, count=campaign.count(INPUTS)),
        partial(large, count=campaign.count(60)),
        partial(retained, count=campaign.count(60)),
        partial(flood, count=campaign.count(6000)),
        partial(asked_properly, count=campaign.count(200)),
    ]
    return campaign.side_by_side(*works, at_once=2)


class Asker:
    """Publishes commands, at most so many unacknowledged at once, and collects the replies."""

    def __init__(self, rig):
        self.rig = rig
        self.client = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        self.client.max_inflight_messages_set(100)
        self.client.connect("127.0.0.1", rig.broker.port)
        self.client.loop_start()

    def ask(self, payload, *, qos=1, retain=False, correlation=None, below="command"):
        properties = None
        if correlation is not None:
            properties = Properties(PacketTypes.PUBLISH)
            properties.CorrelationData = correlation
        return self.client.publish(f"{ROOT}/{below}", payload, qos=qos, retain=retain, properties=properties)

    def replies(self):
        return self.rig.subscriber.of("reply")

    def close(self):
        self.client.disconnect()
        self.client.loop_stop()


def node(campaign, per_minute):
    more = f"[commands]\nper_minute = {per_minute}"
    return Rig(campaign.fresh("commands"), virtual=False, interval_s=PERIOD_S, more=more)


def concluded(rig, asker, title, times, pid, *, inputs=True, broken=(), remark=""):
    """Ask once more as one should, then close the books."""
    broken = list(broken)
    asked_at = time.monotonic()

    def answered():
        # Others may have used up the minute's commands: ask until it is heard.
        if not asker.last or time.monotonic() - asker.last > 1.0:
            asker.last = time.monotonic()
            asker.ask('{"command":"measure","correlation":"at the end"}')
        return any(r["correlation"] == "at the end" and r["ok"] for r in map(parsed, asker.replies()[-50:]))

    asker.last = 0.0
    rig.wait_for(answered, 90, 0.05)
    waited = time.monotonic() - asked_at
    asker.close()
    if rig.daemon.pid != pid or rig.daemon.poll() is not None:
        broken.append("the daemon did not live through it")
    at = [t for t, what, _ in rig.entries() if what == "G"]
    gap = max(b - a for a, b in itertools.pairwise(at))
    if gap > GAP_S:
        broken.append(f"no reading for {gap:.1f} s")
    for word in ("Traceback", "CRITICAL"):
        if word in rig.log():
            broken.append(f"{word} in the log")
    replies = [parsed(message) for message in asker.replies()]
    resent = [reply["resent"] for reply in replies if reply["resent"] is not None]
    # A reply may have been dropped for later ones; what it announced came all the same.
    unheard = rig.log().count("command resend: done") - len(resent)
    resent = sum(resent) + unheard * rig.good() * len(CONDUCTORS)
    rig.last_run()
    remark = f"{remark}{'; ' if remark else ''}{len(replies)} replies, greatest gap between readings {gap:.1f} s"
    return Line.of("commands", title, times, rig.books(), recovery=[waited], limit_s=75.0, broken=broken, inputs=inputs,
                   allowed_repeats=resent + ON_THE_WIRE, remark=remark)  # fmt: skip


def parsed(message):
    """A reply, which must be one by its model."""
    return ReplyMessage.model_validate_json(message.payload).model_dump()


def sent(asker, payloads, **how):
    """Publish them all, and wait until the broker has them."""
    last = None
    for number, payload in enumerate(payloads):
        last = asker.ask(payload, **how)
        if number % 100 == 99:
            last.wait_for_publish(60)
    if last is not None:
        last.wait_for_publish(60)


def mutilated(campaign, count):
    """At the rate that the node hears, and above it: what it cannot read it refuses, and what it can it does."""
    with node(campaign, 600) as rig:
        pid = rig.start().pid
        rig.wait_good(3)
        asker = Asker(rig)
        random = campaign.random
        for _ in range(count // 60):
            payloads = [mutated(random, random.choice(COMMANDS))[: COMMAND_MAX_BYTES * 2] for _ in range(60)]
            correlation = random.choice((None, b"", random.randbytes(40)))
            sent(asker, payloads, qos=random.choice((0, 1, 2)), correlation=correlation)
            time.sleep(0.5)
        return concluded(rig, asker, "mutilated commands over MQTT, to a node that measures", count // 60 * 60, pid)


def large(campaign, count):
    """Payloads and correlation data far beyond what a command may have."""
    with node(campaign, 600) as rig:
        pid = rig.start().pid
        rig.wait_good(3)
        asker = Asker(rig)
        for number in range(count):
            size = campaign.random.choice((COMMAND_MAX_BYTES, COMMAND_MAX_BYTES + 1, 60_000, 1_000_000, 8_000_000))
            correlation = campaign.random.randbytes(60_000) if number % 3 == 0 else None
            asker.ask(b'{"command":"measure","x":"' + b"x" * size, correlation=correlation).wait_for_publish(60)
        return concluded(rig, asker, "commands of up to 8 MB, correlation data of 60 kB", count, pid)


def retained(campaign, count):
    """A retained command is ignored, also by who connects later."""
    with node(campaign, 600) as rig:
        pid = rig.start().pid
        rig.wait_good(3)
        asker = Asker(rig)
        for number in range(count):
            # MQTT gives it to who is connected as a new message and to who comes later as a retained one.
            asker.ask('{"command":"resend","from_sequence":1}', retain=True).wait_for_publish(60)
            if number % 10 == 0:
                rig.witness.break_all()
                rig.wait_for(lambda: (p := rig.page()) and p["broker_connected"], 60)
        time.sleep(1)
        before = len(asker.replies())
        rig.witness.break_all()
        time.sleep(2)
        rig.wait_for(lambda: (p := rig.page()) and p["broker_connected"], 60)
        time.sleep(1)
        broken = [] if len(asker.replies()) == before else ["a retained command was carried out at a connection"]
        asker.ask(b"", retain=True).wait_for_publish(60)
        return concluded(rig, asker, "retained commands, and connections that meet one", count, pid, broken=broken)


def flood(campaign, count):
    """Valid commands as fast as the broker takes them, against the shipped limit of twelve a minute."""
    with node(campaign, 12) as rig:
        pid = rig.start().pid
        rig.wait_good(3)
        asker = Asker(rig)
        began = time.monotonic()
        words = ('{"command":"measure"}', '{"command":"picture","conductor":"L1"}', '{"command":"nothing"}')
        sent(asker, [words[number % 3] for number in range(count)], qos=1)
        rate = count / (time.monotonic() - began)
        return concluded(rig, asker, "flood of commands, above the limit of 12 a minute", count, pid,
                         remark=f"{rate:.0f} a second")  # fmt: skip


def asked_properly(campaign, count):
    """Every valid command below the limit is answered once, with its own correlation."""
    with node(campaign, 600) as rig:
        pid = rig.start().pid
        rig.wait_good(3)
        asker = Asker(rig)
        words = ({"command": "measure"}, {"command": "picture", "conductor": "L2"},
                 {"command": "resend", "from_sequence": 1, "to_sequence": 3})  # fmt: skip
        missing = []
        for number in range(count):
            own = f"number {number}"
            asker.ask(json.dumps({**words[number % 3], "correlation": own}), correlation=own.encode())
            rig.wait_for(lambda own=own: any(own == r["correlation"] for r in map(parsed, asker.replies()[-5:])), 30)
        answers = [parsed(message)["correlation"] for message in asker.replies()]
        missing = [n for n in range(count) if answers.count(f"number {n}") != 1]
        broken = [f"{len(missing)} commands were not answered once"] if missing else []
        return concluded(rig, asker, "valid commands, each answered", count, pid, inputs=False, broken=broken)
