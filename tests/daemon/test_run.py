"""The whole daemon as a process: started, stopped, killed, reloaded, with the real worker."""

import contextlib
import json
import shutil
import signal
import socket
from pathlib import Path

import pytest
from brokers import MOSQUITTO, Mosquitto, Subscriber
from descriptors import descriptors
from nodes import NO_CAMERA, SITE, readings, start_daemon, status, wait_for, write_node

FRAMES = sorted((SITE / "frames").glob("*T1[2-3]*.jpg"))


@pytest.fixture
def site(tmp_path):
    """The demonstration's site with a node file of the test's own."""

    def write(camera=NO_CAMERA, schedule="interval_s = 0.5", more=""):
        return write_node(tmp_path, camera, f"{schedule}\ndeadline_s = 30", more)

    return write


@pytest.fixture
def start(tmp_path):
    started = []

    def build(node, **environment):
        process = start_daemon(node, tmp_path / "log", **environment)
        started.append(process)
        return process

    yield build
    for process in started:
        process.kill()
        process.wait()


@pytest.mark.skipif(len(FRAMES) < 2, reason="the demonstration's frames are not there")
def test_a_replay_is_measured_recorded_and_ended(tmp_path, site, start):
    (tmp_path / "frames").mkdir()
    for frame in FRAMES[:2]:
        shutil.copy(frame, tmp_path / "frames")
    node = site('backend = "replay"\nreplay = { path = "frames" }', 'interval_s = 1800\nclock = "virtual"')
    assert start(node).wait(60) == 0, (tmp_path / "log").read_text()
    made = readings(tmp_path)
    assert len(made) == 6
    assert sorted({r["acquired_at"] for r in made})[0].startswith("2026-06-21T12:00:00")
    assert all(r["frames_used"] + r["frames_rejected"] == 1 for r in made)
    assert any(r["sag_m"] is not None for r in made)
    assert made[0]["configuration_id"] == status(tmp_path)["configuration_id"]
    assert made[0]["calibration_id"] != "unknown"
    assert (tmp_path / "state" / "pictures" / "L1.jpg").stat().st_size > 10_000


def test_a_missing_camera_gives_invalid_readings_with_the_reason_and_the_daemon_lives(tmp_path, site, start):
    process = start(site())
    wait_for(lambda: (s := status(tmp_path)) and s["health"]["readings_made"] >= 6)
    assert process.poll() is None
    for reading in readings(tmp_path):
        assert reading["quality"]["validity"] == "invalid"
        assert reading["sag_m"] is None
    assert any("/dev/video99" in r["quality"]["reasons"][0]["text"] for r in readings(tmp_path))
    assert "/dev/video99" in status(tmp_path)["health"]["camera"]
    assert "Traceback" not in (tmp_path / "log").read_text()


def test_a_second_daemon_on_the_same_state_is_refused(tmp_path, site, start):
    node = site()
    start(node)
    wait_for(lambda: status(tmp_path))
    second = start(node)
    assert second.wait(20) == 1
    assert "in use by another sagnode" in (tmp_path / "log").read_text()


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (("interval_s = 0.5", "interval_s = 0.5\ncron = '* * * * *'"), "exactly one"),
        (("interval_s = 0.5", "cron = '99 * * * *'"), "schedule.cron"),
        (('unit = "n"', 'unit = "n"\nunti = 3'), "unti"),
    ],
)
def test_a_bad_configuration_does_not_start(tmp_path, site, start, change, text):
    node = site()
    node.write_text(node.read_text().replace(*change))
    assert start(node).wait(20) == 2
    log = (tmp_path / "log").read_text()
    assert text in log
    assert "Traceback" not in log


def test_systemd_is_told_and_a_stop_waits_for_nobody(tmp_path, site, start):
    address = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(address)
        manager.settimeout(20)
        process = start(site(), NOTIFY_SOCKET=address, WATCHDOG_USEC="3000000")
        heard = b""
        while b"WATCHDOG=1" not in heard or b"READY=1" not in heard:
            heard += manager.recv(4096) + b"\n"
        process.send_signal(signal.SIGTERM)
        # a daemon that waits for its worker or its broker would take their deadlines, which are longer
        assert process.wait(20) == 0
        manager.settimeout(0.2)
        with contextlib.suppress(TimeoutError):
            while True:
                heard += manager.recv(4096) + b"\n"
    assert b"STOPPING=1" in heard
    assert status(tmp_path)["state"] == "stopped"


def test_killed_outright_its_worker_goes_too_and_numbers_go_on(tmp_path, site, start):
    node = site()
    process = start(node)
    wait_for(lambda: (s := status(tmp_path)) and s["health"]["readings_made"] >= 3)
    process.kill()
    process.wait()
    wait_for(lambda: not _children_of(node), 5)
    held = [r["sequence"] for r in readings(tmp_path)]
    start(node)
    wait_for(lambda: len(readings(tmp_path)) >= len(held) + 3)
    after = [r["sequence"] for r in readings(tmp_path)]
    assert after == list(range(1, len(after) + 1))


def _children_of(node):
    found = []
    for command in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            words = command.read_bytes()
            if b"sagnode.worker" in words and str(node).encode() in words:
                found.append(command)
    return found


def test_reload_takes_a_good_configuration_and_refuses_a_bad_one(tmp_path, site, start):
    node = site()
    process = start(node)
    first = wait_for(lambda: status(tmp_path))["configuration_id"]
    good = node.read_text()
    node.write_text(good + "\n[nonsense]\n")
    process.send_signal(signal.SIGHUP)
    wait_for(lambda: status(tmp_path)["health"]["configuration"] != "ok")
    refused = status(tmp_path)
    assert "nonsense" in refused["health"]["configuration"]
    assert refused["configuration_id"] == first
    assert (tmp_path / "log").read_text().count("state in") == 1  # nothing was taken down for it
    made = len(readings(tmp_path))
    wait_for(lambda: len(readings(tmp_path)) >= made + 6)  # by a worker that was started after the refusal
    causes = {reason["cause"] for r in readings(tmp_path)[made:] for reason in r["quality"]["reasons"]}
    assert "bad-calibration" not in causes
    reference = (tmp_path / "reference.jpg").read_bytes()
    node.write_text(good)
    (tmp_path / "reference.jpg").write_bytes(b"no picture at all")
    process.send_signal(signal.SIGHUP)
    wait_for(lambda: "reference_image" in status(tmp_path)["health"]["configuration"])
    assert status(tmp_path)["configuration_id"] == first
    (tmp_path / "reference.jpg").write_bytes(reference)
    node.write_text(good.replace('unit = "n"', 'unit = "other"'))
    process.send_signal(signal.SIGHUP)
    wait_for(lambda: status(tmp_path)["health"]["configuration"] == "ok")
    assert status(tmp_path)["unit"]["unit"] == "other"
    assert status(tmp_path)["configuration_id"] != first
    assert process.poll() is None


@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_a_reload_leaves_nothing_open(tmp_path, site, start):
    with Mosquitto(tmp_path) as broker:
        node = site(more=f'[mqtt]\nhost = "127.0.0.1"\nport = {broker.port}')
        process = start(node)

        def connections():
            return (tmp_path / "log").read_text().count("connected to broker")

        wait_for(connections)
        kept = []
        for reloads in range(1, 4):
            process.send_signal(signal.SIGHUP)
            wait_for(lambda reloads=reloads: connections() > reloads)
            made = len(readings(tmp_path))
            wait_for(lambda made=made: len(readings(tmp_path)) > made)
            # of pipes alone: a worker that comes or goes has some for a moment, so the fewest count
            kept.append(min(sum(one.startswith("pipe:") for one in descriptors(process.pid)) for _ in range(50)))
        assert kept[0] == kept[-1], kept
        assert process.poll() is None


@pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")
def test_killed_and_restarted_beside_a_broker_nothing_is_lost(tmp_path, site, start):
    with Mosquitto(tmp_path) as broker, Subscriber(broker.port, "sagnode/#") as subscriber:
        node = site(schedule="interval_s = 0.2", more=f"[mqtt]\nhost = '127.0.0.1'\nport = {broker.port}")
        for round_ in range(3):
            process = start(node)
            wait_for(lambda: (s := status(tmp_path)) and s["broker_connected"] and s["health"]["readings_made"] >= 6)
            if round_ < 2:
                process.kill()
                process.wait()
                (tmp_path / "state" / "status.json").unlink()
        process.send_signal(signal.SIGTERM)
        assert process.wait(10) == 0
        made = [r["sequence"] for r in readings(tmp_path)]
        assert made == list(range(1, len(made) + 1))
        subscriber.wait_for(lambda s: {r["sequence"] for r in s.readings()} == set(made))
        assert json.loads(subscriber.of("status")[-1].payload)["state"] == "offline"
        assert json.loads(subscriber.of("health")[-1].payload)["broker"].startswith("connected")
        states = [json.loads(m.payload)["state"] for m in subscriber.of("status")]
        assert states.count("online") == 3
        assert states.count("offline") == 3  # two last wills and a farewell
