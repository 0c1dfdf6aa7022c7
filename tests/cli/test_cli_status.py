"""``sagnode status``: what it says, its exit code, and how fast it is."""

import fcntl
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from readings import fill

from sagnode.cli.main import main
from sagnode.daemon.journal import Journal
from sagnode.daemon.report import examine

BOOT = Path("/proc/sys/kernel/random/boot_id").read_text().strip()


def reading(**fields):
    values = {
        f"{stem}_{part}": v for stem in ("sag", "clearance") for part, v in (("m", 8.0), ("lo", 7.9), ("hi", 8.1))
    }
    return {
        "sequence": 7,
        "acquired_at": "2026-06-01T12:00:00+00:00",
        "recorded_monotonic_s": time.monotonic() - 125,
        "validity": "good",
        "reasons": [],
        **values,
        **fields,
    }


def page(state_dir, **fields):
    health = {
        "uptime_s": 90061.0,
        "cpu_temperature_c": 48.3,
        "throttled": False,
        "memory_available_mb": 312.0,
        "disk_free_mb": 8123.0,
        "camera": "ok: picamera2",
        "readings_made": 9,
        "readings_invalid": 1,
        "outbox_depth": 0,
        "outbox_oldest_s": None,
        "broker": "connected to broker.example:8883",
        "journal": "ok",
        "configuration": "ok",
        **fields.pop("health", {}),
    }
    return {
        "schema_version": "sagnode.status-file/1",
        "state": "running",
        "software_version": "0.1.0",
        "unit": {"utility": "u", "line": "l", "span": "s", "unit": "n"},
        "pid": 1,
        "boot_id": BOOT,
        "state_dir": str(state_dir),
        "written_at": time.time(),
        "written_monotonic_s": time.monotonic(),
        "now": "2026-06-01T12:02:00+00:00",
        "virtual_clock": False,
        "clock": {"synced": True, "source": "kernel"},
        "next_slot": "2026-06-01T12:15:00+00:00",
        "gap_s": 900.0,
        "deadline_s": 60.0,
        "broker_connected": True,
        "waiting_in_memory": 0,
        "conductors": ["L1"],
        "readings": {"L1": reading()},
        "health": health,
        **fields,
    }


@pytest.fixture
def node(tmp_path):
    """Write a status page while a daemon seems to hold the lock."""
    held = (tmp_path / "lock").open("w")
    fcntl.flock(held, fcntl.LOCK_EX)

    def write(**fields):
        (tmp_path / "status.json").write_text(json.dumps(page(tmp_path, **fields)))
        return tmp_path

    write.release = held.close
    yield write
    held.close()


def test_all_is_well(node, capsys):
    state = node()
    assert main(["status", "--state-dir", str(state)]) == 0
    said = capsys.readouterr().out
    assert "u/l/s/n   running, up 1 d 1 h" in said
    assert re.search(r"L1  sag 8\.00 \[7\.90 8\.10\] m  clearance 8\.00 .* good  2 min \d+ s ago", said)
    assert "broker      connected to broker.example:8883" in said
    assert "8.1 GB free" in said
    assert "48 °C" in said
    assert "synchronised (says: kernel)" in said
    assert said.splitlines()[-1] == "fine"


def test_a_models_lengths_are_told_to_a_tenth_of_a_millimetre(node, capsys):
    small = reading(sag_m=0.0904, sag_lo=0.0895, sag_hi=0.0913, clearance_m=0.18, clearance_lo=0.17, clearance_hi=0.19)
    assert main(["status", "--state-dir", str(node(readings={"L1": small}))]) == 0
    assert "L1  sag 0.0904 [0.0895 0.0913] m  clearance 0.180 [0.170 0.190] m" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"readings": {}}, "L1: no reading since the start"),
        (
            {"readings": {"L1": reading(validity="invalid", sag_m=None, reasons=[{"cause": "dark", "text": "night"}])}},
            "L1: last reading invalid (dark)",
        ),
        ({"readings": {"L1": reading(recorded_monotonic_s=time.monotonic() - 7200)}}, "L1: last reading is stale, 2 h"),
        (
            {"broker_connected": False, "health": {"broker": "b:1: connection refused"}},
            "broker: b:1: connection refused",
        ),
        ({"waiting_in_memory": 3, "health": {"journal": "disk is full"}}, "journal: disk is full"),
        ({"health": {"disk_free_mb": 12.0}}, "disk: only 12 MB free"),
        ({"health": {"throttled": True}}, "throttled"),
        ({"health": {"trend": "contradicts its past: L1 (2 readings)"}}, "trend: contradicts its past: L1"),
        (
            {"alarms": [{"kind": "clearance", "conductor": "L1", "since": "2026-06-01T12:00:00Z", "text": "5.9 m"}]},
            "alarm: clearance of L1 since",
        ),
        ({"health": {"configuration": "reload refused"}}, "configuration: reload refused"),
        ({"written_monotonic_s": time.monotonic() - 600}, "has not shown itself for 1"),
    ],
)
def test_troubles_are_told_and_exit_with_one(node, capsys, fields, problem):
    assert main(["status", "--state-dir", str(node(**fields))]) == 1
    assert problem in capsys.readouterr().out


def test_a_questionable_reading_is_shown_with_its_reason_and_is_no_trouble(node, capsys):
    reasons = [{"cause": "uncertain", "text": "u is 0.3 m"}]
    assert (
        main(["status", "--state-dir", str(node(readings={"L1": reading(validity="questionable", reasons=reasons)}))])
        == 0
    )
    assert "uncertain: u is 0.3 m" in capsys.readouterr().out


def test_the_age_of_what_landmarks_are_recognised_by(node, capsys):
    landmarks = {
        "reference_taken_at": "2025-05-01T12:02:00+00:00",
        "reference_taken_from": "name",
        "appearances": 4,
        "on_trial": 1,
        "oldest_at": "2026-03-01T12:02:00+00:00",
        "newest_at": "2026-06-01T07:02:00+00:00",
    }
    state = node(health={"landmarks": landmarks}, readings={"L1": reading(landmarks_by_appearance=2)})
    assert main(["status", "--state-dir", str(state)]) == 0
    assert (
        "reference picture 396 d old; 4 appearances kept, 5 h to 92 d old; 2 found by them" in capsys.readouterr().out
    )
    copied = {**landmarks, "reference_taken_from": "modified", "appearances": 0, "oldest_at": None, "newest_at": None}
    assert main(["status", "--state-dir", str(node(health={"landmarks": copied}))]) == 0
    assert "reference picture at least 396 d old; 0 appearances kept" in capsys.readouterr().out
    for origin in ("modified", "name"):
        later = {**copied, "reference_taken_at": "2026-11-23T08:00:00+00:00", "reference_taken_from": origin}
        assert main(["status", "--state-dir", str(node(health={"landmarks": later}))]) == 0
        assert "reference picture of unknown age; 0 appearances kept" in capsys.readouterr().out


def test_a_daemon_that_is_gone(node, capsys):
    state = node()
    node.release()
    assert main(["status", "--state-dir", str(state)]) == 1
    assert "not running (it ended without a word)" in capsys.readouterr().out


def test_before_the_first_run_and_without_a_directory(tmp_path, capsys):
    assert main(["status", "--state-dir", str(tmp_path)]) == 1
    assert "no daemon has run" in capsys.readouterr().out
    assert main(["status", "--state-dir", str(tmp_path / "nowhere")]) == 2
    assert main(["status", "--config", str(tmp_path / "nowhere.toml")]) == 2


def test_the_state_directory_of_a_configuration(node, tmp_path, capsys):
    state = node()
    (tmp_path / "node.toml").write_text(f"[storage]\nstate_dir = '{state.name}'\n")
    (tmp_path / "up").mkdir()
    config = tmp_path.parent / "node-of-status.toml"
    config.write_text(f"broken = [1\n[storage]\nstate_dir = '{state.name}'\n")
    assert main(["status", "--config", str(config)]) == 2
    config.write_text(f"unknown_key = 1\n[storage]\nstate_dir = '{state.name}'\n")
    assert main(["status", "--config", str(config)]) == 0, capsys.readouterr()


def test_json_is_whole(node, capsys):
    assert main(["status", "--json", "--state-dir", str(node())]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["verdict"] == "fine"
    assert report["running"] is True
    assert 120 < report["status"]["readings"]["L1"]["age_s"] < 140


def test_a_damaged_page_and_a_damaged_journal_are_no_traceback(tmp_path, capsys):
    (tmp_path / "status.json").write_text('{"half": ')
    (tmp_path / "journal.sqlite").write_bytes(b"not a database" * 100)
    assert main(["status", "--state-dir", str(tmp_path)]) == 1
    assert examine(tmp_path)["status"] is None


def without(document, *path):
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    del inner[path[-1]]


@pytest.mark.parametrize(
    "change",
    [
        lambda p: [without(p, key) for key in list(p) if key != "written_at"],
        lambda p: p.update(schema_version="sagnode.status-file/2"),
        lambda p: without(p, "readings"),
        lambda p: without(p, "health", "journal"),
        lambda p: without(p, "health", "readings_invalid"),
        lambda p: without(p, "readings", "L1", "reasons"),
        lambda p: p.update(readings=[]),
        lambda p: p.update(health=None),
        lambda p: p.update(now="yesterday"),
        lambda p: p.update(written_at=None),
        lambda p: p["health"].update(throttled="a little"),
        lambda p: p["health"].update(landmarks={"appearances": "one"}),
        lambda p: p.update(alarms=[{"kind": "sag"}]),
    ],
)
@pytest.mark.parametrize("words", [(), ("--json",)])
def test_a_page_of_another_shape_is_told_and_no_defect(node, capsys, change, words):
    state = node()
    document = page(state)
    change(document)
    (state / "status.json").write_text(json.dumps(document))
    assert main(["status", *words, "--state-dir", str(state)]) == 1
    said = capsys.readouterr()
    assert said.err == ""
    assert "status.json is damaged, or was written by another version of sagnode; restart the service" in said.out


def test_what_may_be_unknown_may_be_missing(node, capsys):
    assert main(["status", "--state-dir", str(node(health={"landmarks": {"appearances": 1}}))]) == 0
    assert "1 appearances kept" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["", "[]", "7", "[" * 100_000, '{"written_at": 1}', "\x00"])
def test_whatever_stands_in_the_place_of_a_page_is_no_defect(tmp_path, capsys, text):
    (tmp_path / "status.json").write_text(text)
    assert main(["status", "--state-dir", str(tmp_path)]) == 1
    assert "it goes with the next start" in capsys.readouterr().out


@pytest.mark.parametrize("name", [*page(Path("/s")), *(f"health.{key}" for key in page(Path("/s"))["health"])])
def test_whichever_key_is_missing_there_is_an_answer(node, capsys, name):
    state = node()
    document = page(state)
    without(document, *name.split("."))
    (state / "status.json").write_text(json.dumps(document))
    assert main(["status", "--state-dir", str(state)]) in {0, 1}
    assert capsys.readouterr().err == ""


def test_without_a_page_the_journal_tells_the_last_readings(tmp_path, capsys):
    journal = Journal(tmp_path / "journal.sqlite")
    fill(journal, 2, ("L1", "L2"))
    assert main(["status", "--state-dir", str(tmp_path)]) == 1
    said = capsys.readouterr().out
    assert "L2  sag 8.00" in said
    assert "4 readings wait" in said


def test_it_imports_nothing_heavy(node):
    """What takes time are imports; how much time, ``benchmarks/performance/run.py`` says."""
    state = node()
    script = (
        "import sys\nfrom sagnode.cli.main import main\n"
        f"code = main(['status', '--state-dir', {str(state)!r}])\n"
        "heavy = {'numpy', 'cv2', 'pydantic', 'paho', 'apscheduler'} & set(sys.modules)\n"
        "sys.exit(code if not heavy else f'imported {heavy}')"
    )
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
