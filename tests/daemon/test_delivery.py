"""A broker that accepts the log-in and takes no readings: told by health, status and doctor."""

import json

import pytest
from brokers import MOSQUITTO, Mosquitto, Subscriber, free_port
from nodes import start_daemon, status, wait_for, write_node
from readings import START, fill

from sagnode.daemon.delivery import STUCK_S, Delivery
from sagnode.daemon.journal import Journal
from sagnode.daemon.outbox import SET_ASIDE_S
from sagnode.daemon.report import examine
from sagnode.doctor import examine as doctor
from sagnode.doctor.broker import DELIVERY, LOGIN
from sagnode.doctor.findings import Level

needs_mosquitto = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


def access_list(directory, *topics):
    file = directory / "access"
    file.write_text("topic read #\n" + "".join(f"topic write {topic}\n" for topic in topics))
    file.chmod(0o644)
    return f"acl_file {file}"


@pytest.fixture
def daemon(tmp_path):
    started = []

    def start(port):
        mqtt = f'[mqtt]\nhost = "127.0.0.1"\nport = {port}\nprefix = "t/1"'
        node = write_node(tmp_path, schedule="interval_s = 1\ndeadline_s = 30", more=mqtt)
        started.append(start_daemon(node, tmp_path / "log"))
        return node

    yield start
    for process in started:
        process.kill()
        process.wait()


def problems(directory):
    return [text for text in examine(directory / "state")["problems"] if text.startswith("delivery: ")]


@needs_mosquitto
def test_an_access_list_without_measurements_is_a_trouble_for_status_health_and_doctor(tmp_path, daemon):
    permits = access_list(tmp_path, "t/1/status", "t/1/health", "t/1/alarm/#")
    with Mosquitto(tmp_path, permits) as broker, Subscriber(broker.port) as subscriber:
        node = daemon(broker.port)
        wait_for(lambda: (s := status(tmp_path)) and s["health"]["outbox_set_aside"] >= 6)
        (told,) = problems(tmp_path)
        assert "Not authorized" in told
        assert "below t/1/" in told
        subscriber.wait_for(lambda s: any(json.loads(m.payload)["outbox_set_aside"] >= 6 for m in s.of("health")))
        assert not subscriber.readings()
        found = {one.check: one for one in doctor.examine(node, {"system", "camera"})}
    assert found[LOGIN].level is Level.OK
    assert found[DELIVERY].level is Level.FAULT
    assert "access list" in found[DELIVERY].remedy


@needs_mosquitto
def test_alarms_that_the_broker_does_not_take_are_a_trouble_too(tmp_path, daemon):
    permits = access_list(tmp_path, "t/1/status", "t/1/health", "t/1/measurement/#")
    with Mosquitto(tmp_path, permits) as broker:
        node = daemon(broker.port)
        (told,) = wait_for(lambda: problems(tmp_path))
        assert "alarm/L1/" in told
        assert "readings (" not in told
        assert node.exists()


@needs_mosquitto
def test_a_broker_that_takes_everything_is_none(tmp_path, daemon):
    with Mosquitto(tmp_path) as broker, Subscriber(broker.port) as subscriber:
        node = daemon(broker.port)
        subscriber.wait_for(lambda s: len(s.readings()) >= 6, 30)
        wait_for(lambda: (s := status(tmp_path)) and s["broker_connected"] and s["health"]["readings_made"] >= 6)
        assert problems(tmp_path) == []
        found = {one.check: one for one in doctor.examine(node, {"system", "camera"})}
    assert found[DELIVERY].level is Level.OK


def test_while_no_daemon_runs_doctor_says_that_delivery_was_not_tried(tmp_path):
    node = write_node(tmp_path, more=f'[mqtt]\nhost = "127.0.0.1"\nport = {free_port()}')
    found = {one.check: one for one in doctor.examine(node, {"system", "camera"})}
    assert found[DELIVERY].level is Level.SKIPPED


@needs_mosquitto
def test_once_the_broker_permits_it_the_readings_arrive_and_nothing_is_left_of_it(tmp_path, node, monkeypatch):
    permits = access_list(tmp_path, "t/1/status")
    with Mosquitto(tmp_path, permits) as broker, Subscriber(broker.port) as subscriber:
        n = node(port=broker.port)
        n.make(2)
        wait_for(lambda: n.link.set_aside == 6)
        assert "6 readings" in n.link.delivery
        access_list(tmp_path, "t/1/#")
        broker.signal(1)  # mosquitto reads its access list anew
        real = n.outbox._monotonic
        monkeypatch.setattr(n.outbox, "_monotonic", lambda: real() + SET_ASIDE_S)
        subscriber.wait_for(lambda s: len(s.readings()) == 6)
        wait_for(lambda: n.journal.backlog().depth == 0)
        assert n.link.delivery == "ok"


class Connection:
    connected = True
    delivery = "ok"


def test_an_oldest_reading_that_nobody_acknowledges_is_a_trouble_however_it_comes_about(tmp_path):
    journal = Journal(tmp_path / "journal.sqlite")
    now = [1000.0]
    delivery, link = Delivery(lambda: now[0]), Connection()
    assert delivery.state(link, journal.backlog()) == "ok"
    fill(journal, 2, ("L1",))
    now[0] += 10 * STUCK_S
    assert delivery.state(link, journal.backlog()) == "ok"  # it is owed only since now
    link.connected = False
    now[0] += 2 * STUCK_S
    assert delivery.state(link, journal.backlog()) == "ok"  # an outage is told by the link itself
    link.connected = True
    assert delivery.state(link, journal.backlog()) == "ok"
    now[0] += STUCK_S - 1
    assert delivery.state(link, journal.backlog()) == "ok"
    now[0] += 2
    assert "reading 1 was not acknowledged for 15 min" in delivery.state(link, journal.backlog())
    journal.mark_delivered([1], START)
    assert delivery.state(link, journal.backlog()) == "ok"  # it goes on
