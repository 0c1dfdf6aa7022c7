"""The whole daemon against the utility's side as shipped: enrolment, refused certificates, renewal without restart."""

import json
import shutil
import subprocess
import sys

import pytest
from brokers import MOSQUITTO
from nodes import readings, start_daemon, status, wait_for, write_node
from utility import CA, Party, UtilityBroker, enrol, ran

pytestmark = pytest.mark.skipif(
    MOSQUITTO is None or shutil.which("openssl") is None, reason="mosquitto or openssl is not installed"
)

UNIT = "u/l/s/n"
MQTT = """
[mqtt]
host = "localhost"
port = {port}
[mqtt.tls]
ca_file = "tls/ca.crt"
cert_file = "tls/unit.pem"
key_file = "tls/unit.pem"
"""

HOSTILE = [
    b"",
    b"\xff\xfe",
    b"[" * 2000,
    b'{"command": "measure", "shell": "reboot"}',
    b'{"command": "format"}',
    b'{"command": "picture", "conductor": "../../tls/unit.pem"}',
    b'{"command": "measure", "correlation": "' + b"x" * 3000,
    b'{"command": "resend", "from_sequence": -1}',
    b'{"command": "resend", "from_sequence": 1e400}',
    bytes(100_000),
]


@pytest.fixture
def ca(tmp_path):
    ran(CA, tmp_path / "ca", "init")
    ran(CA, tmp_path / "ca", "broker", "localhost")
    ran(CA, tmp_path / "ca", "consumer", "scada")
    ran(CA, tmp_path / "ca", "consumer", "operator")
    return tmp_path / "ca"


@pytest.fixture
def unit(tmp_path):
    """Starts the daemon beside a broker; a camera that is not there makes invalid readings, which are readings too."""
    site = tmp_path / "site"
    site.mkdir(exist_ok=True)
    running = []

    def start(broker):
        write_node(site, schedule="interval_s = 0.3\ndeadline_s = 30", more=MQTT.format(port=broker.port))
        running.append(start_daemon(site, tmp_path / "log"))
        return running[-1]

    start.site = site
    yield start
    for process in running:
        process.kill()
        process.wait()


def journalled(site):
    return [reading["sequence"] for reading in readings(site)]


def consumer_named(name, broker, ca):
    keys = ca / "keys"
    return Party(broker.port, ca, keys / f"{name}.crt", key=keys / f"{name}.key", topic=f"sagnode/v1/{UNIT}/#")


def scada(broker, ca):
    return consumer_named("scada", broker, ca)


def sequences(party):
    return {json.loads(m.payload)["sequence"] for m in party.messages if "/measurement/" in m.topic}


@pytest.mark.parametrize(
    ("trouble", "said"),
    [
        ("expired", "unit.pem (certificate expired, ends 2020-01-01"),
        ("revoked", "unit.pem (certificate revoked, ends"),
    ],
)
def test_a_refused_certificate_is_told_readings_are_kept_and_renewal_needs_no_restart(
    tmp_path, ca, unit, trouble, said
):
    tls = unit.site / "tls"
    match trouble:
        case "expired":
            enrol(ca, tls, UNIT, by_hand=True, UNTIL="20200101000000Z")
        case "revoked":
            enrol(ca, tls, UNIT)
            ran(CA, ca, "revoke", UNIT)
    shutil.copy(ca / "ca.crt", tls / "ca.crt")
    with UtilityBroker(tmp_path, ca) as broker, scada(broker, ca) as consumer:
        process = unit(broker)
        wait_for(lambda: said in (tmp_path / "log").read_text())
        wait_for(lambda: (s := status(unit.site)) and s["health"]["readings_made"] >= 6)
        assert not consumer.messages
        assert status(unit.site)["health"]["outbox_depth"] >= 6
        enrol(ca, tls, UNIT)
        wait_for(lambda: status(unit.site)["broker_connected"])
        made = set(journalled(unit.site))
        consumer.wait_for(lambda c: made <= sequences(c), 15)
        assert process.poll() is None
        assert "Traceback" not in (tmp_path / "log").read_text()


def test_what_the_access_list_forbids_is_kept_and_told(tmp_path, ca, unit):
    """A certificate for another name: the broker lets it in, and takes nothing below this one."""
    enrol(ca, unit.site / "tls", "u/l/s/other")
    with UtilityBroker(tmp_path, ca) as broker, scada(broker, ca) as consumer:
        unit(broker)
        wait_for(lambda: (s := status(unit.site)) and s["health"]["outbox_depth"] >= 6)
        said = (tmp_path / "log").read_text()
        assert "does not take status: the broker answered: Not authorized" in said
        assert "reading 1 set aside" in said and "the broker answered: Not authorized" in said
        assert not consumer.messages


def test_the_end_of_the_certificate_is_told_beforehand(tmp_path, ca, unit):
    enrol(ca, unit.site / "tls", UNIT, DAYS="20")
    with UtilityBroker(tmp_path, ca) as broker, scada(broker, ca) as consumer:
        unit(broker)
        consumer.wait_for(lambda c: [m for m in c.messages if m.topic.endswith("/health")], 20)
        health = json.loads(next(m for m in consumer.messages if m.topic.endswith("/health")).payload)
        words = [sys.executable, "-m", "sagnode", "status", "--state-dir", str(unit.site / "state")]
        shown = subprocess.run(words, capture_output=True, text=True)
        assert shown.returncode == 1
        assert "certificate: mqtt.tls.cert_file ends in 19 d" in shown.stdout
        ends = ran(
            "openssl", "x509", "-in", unit.site / "tls/unit.pem", "-noout", "-enddate", "-dateopt", "iso_8601"
        ).stdout
        assert health["certificate_ends_at"] == ends.strip().removeprefix("notAfter=").replace(" ", "T")


def test_a_broker_of_another_name_or_authority_gets_nothing(tmp_path, ca, unit):
    """Neither password nor reading: the connection ends before CONNECT."""
    enrol(ca, unit.site / "tls", UNIT)
    ran(CA, ca, "broker", "somewhere.example.org")
    with UtilityBroker(tmp_path, ca) as broker:
        unit(broker)
        said = wait_for(
            lambda: (s := status(unit.site)) and "not accepted" in s["health"]["broker"] and s["health"]["broker"]
        )
        assert "Hostname mismatch" in said and "check mqtt.host" in said
        assert "connected from" not in broker.log.read_text()


def test_hostile_commands_change_nothing_and_the_unit_goes_on(tmp_path, ca, unit):
    """An operator's stolen certificate: everything but a sound command is refused, and a flood is not even answered."""
    enrol(ca, unit.site / "tls", UNIT)
    topic = f"sagnode/v1/{UNIT}/command"
    with UtilityBroker(tmp_path, ca) as broker, consumer_named("operator", broker, ca) as operator:
        operator.publish(topic, b'{"command": "resend", "from_sequence": 1}', retain=True)  # waits for the unit
        operator.messages.clear()
        process = unit(broker)

        def replies():
            return [json.loads(m.payload) for m in operator.messages if m.topic.endswith("/reply")]

        wait_for(lambda: (s := status(unit.site)) and s["broker_connected"])
        for hostile in HOSTILE:
            operator.publish(topic, hostile)
        wait_for(lambda: len(replies()) >= 8)
        assert not [reply for reply in replies() if reply["ok"]]
        for _ in range(300):
            operator.client.publish(topic, b'{"command": "picture", "conductor": "L1"}', qos=0)
        before = status(unit.site)["health"]["readings_made"]
        wait_for(lambda: status(unit.site)["health"]["readings_made"] >= before + 6)
        assert len(replies()) < 60  # 12 a minute, and as many refusals
        assert process.poll() is None
        log = (tmp_path / "log").read_text()
        assert "Traceback" not in log
        assert "PRIVATE KEY" not in "".join(m.payload.decode(errors="replace") for m in operator.messages)
