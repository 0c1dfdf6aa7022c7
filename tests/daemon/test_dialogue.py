"""Alarms, commands and pictures of the whole daemon, with the real worker, over a real mosquitto."""

import contextlib
import json
import os
import re
import shutil
import sqlite3
import subprocess
import sys
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import paho.mqtt.client as mqtt
import pytest
from brokers import MOSQUITTO, Mosquitto, Subscriber
from paho.mqtt.enums import CallbackAPIVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from pydantic import TypeAdapter

from sagnode.asyncapi import CHANNELS, PREFIX
from sagnode.exchange import AlarmMessage, ReplyMessage
from sagnode.message import HealthMessage, Reading, StatusMessage

SITE = Path(str(files("sagnode.demo") / "site"))
FRAMES = sorted((SITE / "frames").glob("*T1[2-3]*.jpg"))
ROOT = "sagnode/v1/u/l/s/n"

pytestmark = [
    pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed"),
    pytest.mark.skipif(len(FRAMES) < 3, reason="the demonstration's frames are not there"),
]


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """A daemon that measures once at its start and then only when it is asked; its limit of clearance is too high."""
    with running(tmp_path_factory.mktemp("node"), "5") as made:
        yield made


@contextlib.contextmanager
def running(directory, protocol):
    for file in ("camera.yaml", "reference.jpg"):
        shutil.copy(SITE / file, directory)
    span = (SITE / "span.toml").read_text().replace("clearance_min_m = 6.0", "clearance_min_m = 9.0")
    (directory / "span.toml").write_text(span)
    (directory / "frames").mkdir()
    for frame in FRAMES[:3]:
        shutil.copy(frame, directory / "frames")
    with Mosquitto(directory) as broker, Subscriber(broker.port, "sagnode/#") as subscriber:
        (directory / "node.toml").write_text(
            f"""
span_file = "span.toml"
unit = {{ utility = "u", line = "l", span = "s", unit = "n" }}
camera = {{ backend = "replay", replay = {{ path = "frames", at_end = "loop" }} }}
schedule = {{ interval_s = 3600, deadline_s = 60 }}
storage = {{ state_dir = "state" }}
mqtt = {{ host = "127.0.0.1", port = {broker.port}, protocol = "{protocol}" }}
commands = {{ per_minute = 60 }}
"""
        )
        asker = mqtt.Client(CallbackAPIVersion.VERSION2, protocol=mqtt.MQTTv5)
        asker.connect("127.0.0.1", broker.port)
        asker.loop_start()
        made = SimpleNamespace(directory=directory, subscriber=subscriber, asker=asker, port=broker.port)
        start(made)
        yield made
        asker.disconnect()
        asker.loop_stop()
        made.process.kill()
        made.process.wait()


def start(node):
    log = (node.directory / "log").open("ab")
    environment = {k: v for k, v in os.environ.items() if k not in {"STATE_DIRECTORY", "RUNTIME_DIRECTORY"}}
    command = [sys.executable, "-m", "sagnode", "run", "--config", str(node.directory / "node.toml")]
    before = len(node.subscriber.readings())
    node.process = subprocess.Popen(command, stderr=log, stdout=log, env=environment)
    node.subscriber.wait_for(lambda s: len(s.readings()) >= before + 3, 40)


def ask(node, command, *, correlation=None, retain=False, topic="command"):
    properties = Properties(PacketTypes.PUBLISH)
    if correlation is not None:
        properties.CorrelationData = correlation
    payload = command if isinstance(command, bytes) else json.dumps(command).encode()
    node.asker.publish(f"{ROOT}/{topic}", payload, qos=1, retain=retain, properties=properties).wait_for_publish(5)


def reply_to(node, command, **options):
    before = len(node.subscriber.of("reply"))
    ask(node, command, **options)
    node.subscriber.wait_for(lambda s: len(s.of("reply")) > before, 20)
    return node.subscriber.of("reply")[before]


def read(message):
    return ReplyMessage.model_validate_json(message.payload)


def raise_clearance(node):
    """The first reading showed it, this one raises it."""
    if not any(m.payload for m in node.subscriber.of("alarm/L1/clearance")):
        assert read(reply_to(node, {"command": "measure"})).ok
        node.subscriber.wait_for(lambda s: any(m.payload for m in s.of("alarm/L1/clearance")))
    return AlarmMessage.model_validate_json(node.subscriber.of("alarm/L1/clearance")[-1].payload)


def test_measure_now_makes_readings_and_the_reply_names_them(node):
    message = reply_to(node, {"command": "measure", "correlation": "abc"}, correlation=b"\x01\x02")
    reply = read(message)
    assert (reply.ok, reply.command, reply.correlation) == (True, "measure", "abc")
    assert set(reply.sequences) == {"L1", "L2", "L3"}
    assert not message.retain
    assert message.properties.CorrelationData == b"\x01\x02"
    wanted = set(reply.sequences.values())
    node.subscriber.wait_for(lambda s: wanted <= {r["sequence"] for r in s.readings()})


def test_an_alarm_is_retained_with_its_picture_and_survives_a_kill(node):
    alarm = raise_clearance(node)
    assert alarm.limit == 9.0
    assert alarm.lo < alarm.value < alarm.hi < 9.0
    node.subscriber.wait_for(lambda s: s.of("picture/L1"))
    node.process.kill()
    node.process.wait()
    start(node)
    with Subscriber(node.port, "sagnode/#") as late:
        late.wait_for(lambda s: s.of("alarm/L1/clearance"))
        held = late.of("alarm/L1/clearance")[0]
        assert held.retain
        assert AlarmMessage.model_validate_json(held.payload).event_id == alarm.event_id
        assert late.of("alarm/L3/clearance") == []  # it hangs higher
    status = json.loads((node.directory / "state" / "status.json").read_text())
    assert alarm.event_id in {a["event_id"] for a in status["alarms"]}


def test_a_picture_is_sent_when_it_is_asked_for(node):
    before = len(node.subscriber.of("picture/L2"))
    reply = read(reply_to(node, {"command": "picture", "conductor": "L2"}))
    assert reply.ok
    node.subscriber.wait_for(lambda s: len(s.of("picture/L2")) > before)
    picture = node.subscriber.of("picture/L2")[-1]
    assert picture.payload[:3] == b"\xff\xd8\xff"
    assert not picture.retain
    assert picture.properties.ContentType == "image/jpeg"
    assert ("sequence", str(reply.picture_of)) in picture.properties.UserProperty
    refused = read(reply_to(node, {"command": "picture", "conductor": "L9"}))
    assert not refused.ok
    assert "no conductor L9; there are L1, L2, L3" in refused.error


def settled(node):
    """How many readings have come once none is owed; acknowledgements are written some time after they came."""

    def owed():
        with contextlib.closing(sqlite3.connect(node.directory / "state" / "journal.sqlite")) as db:
            return db.execute("SELECT count(*) FROM readings WHERE fate <> 'delivered'").fetchone()[0]

    node.subscriber.wait_for(lambda _: not owed())
    return len(node.subscriber.readings())


def test_readings_are_sent_again_when_asked_for_as_backfill(node):
    before = settled(node)
    reply = read(reply_to(node, {"command": "resend", "from_sequence": 1, "to_sequence": 2}))
    assert (reply.ok, reply.resent) == (True, 2)
    node.subscriber.wait_for(lambda s: len(s.readings()) >= before + 2)
    again = node.subscriber.readings()[before:]
    assert sorted(r["sequence"] for r in again) == [1, 2]
    assert all(r["backfill"] for r in again)
    beyond = read(reply_to(node, {"command": "resend", "from_sequence": 10**9}))
    assert "the newest reading is" in beyond.error


def test_a_bad_command_is_answered_and_does_nothing_and_a_retained_one_not_even_that(node):
    made, answered = settled(node), len(node.subscriber.of("reply"))
    ask(node, {"command": "measure"}, retain=True)
    ask(node, b"", retain=True)  # takes it back; no command by itself, and retained as well
    refused = read(reply_to(node, {"command": "measure", "now": True}))
    assert not refused.ok
    assert "now" in refused.error
    assert len(node.subscriber.of("reply")) == answered + 1
    assert len(node.subscriber.readings()) == made


def test_everything_that_was_published_is_in_the_asyncapi_document(node):
    raise_clearance(node)
    models = {
        "status": StatusMessage,
        "measurement": Reading,
        "health": HealthMessage,
        "alarm": AlarmMessage,
        "reply": ReplyMessage,
    }
    seen = set()
    for message in node.subscriber.messages:
        (channel,) = [
            c for c in CHANNELS if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", f"{PREFIX}/{c.topic}"), message.topic)
        ]
        seen.add(channel.name)
        if channel.name in models and message.payload:
            TypeAdapter(models[channel.name]).validate_json(message.payload)
    assert {"status", "measurement", "health", "alarm", "picture"} <= seen
    assert "Traceback" not in (node.directory / "log").read_text()


def test_by_mqtt_3_1_1_the_payload_bears_the_correlation(tmp_path):
    with running(tmp_path, "3.1.1") as node:
        reply = read(reply_to(node, {"command": "measure", "correlation": "abc"}))
        assert (reply.ok, reply.correlation) == (True, "abc")
        refused = read(reply_to(node, {"command": "no", "correlation": "def"}))
        assert (refused.ok, refused.correlation) == (False, "def")
