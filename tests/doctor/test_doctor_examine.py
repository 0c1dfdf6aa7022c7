"""The whole round on real files: what it finds, what it says to do, and the exit code."""

import json
import os
import sqlite3
import subprocess
import sys
import time

import pytest

from sagnode.cli.main import main
from sagnode.daemon.journal_file import SCHEMA_VERSION
from sagnode.doctor import examine as round_
from sagnode.doctor import place
from sagnode.doctor.findings import Level


def looked(directory, *skip):
    """Findings by check; the last of each."""
    return {finding.check: finding for finding in round_.examine(directory, {"system", *skip})}


def test_a_node_that_can_work_is_fine_and_a_reading_is_made(node, capsys):
    directory = node()
    assert main(["doctor", "--config", str(directory), "--skip", "system", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    found = {finding["check"]: finding for finding in report["findings"]}
    assert report["schema_version"] == "sagnode.doctor/1"
    for check in ("state directory", "calibration", "reference picture", "camera", "reading"):
        assert found[check]["level"] == "ok", found[check]
    assert "sag" in found["reading"]["text"]
    # what was not looked at is told, never passed over
    assert found["journal"]["level"] == found["broker"]["level"] == found["system"]["level"] == "skipped"


def test_a_bad_configuration_is_exit_code_2_and_the_rest_is_looked_at_all_the_same(node, capsys):
    directory = node("[nonsense]\nx = 1")
    assert main(["doctor", "--config", str(directory), "--skip", "system"]) == 2
    out = capsys.readouterr().out
    assert "fault    configuration:" in out and "nonsense" in out
    assert "ok       state directory:" in out
    assert "skipped  camera: not looked at" in out
    assert main(["doctor", "--config", str(directory / "none.toml")]) == 2
    assert main(["doctor", "--config", str(directory / "span.toml"), "--skip", "system"]) == 2


@pytest.mark.parametrize(
    ("name", "content", "check"),
    [
        ("camera.yaml", "image_width: [", "configuration"),
        ("reference.jpg", None, "configuration"),
        ("frames/20260621T120000Z.jpg", b"\xff\xd8 no picture", "camera"),
    ],
)
def test_a_broken_file_is_a_fault_that_names_it(node, name, content, check):
    directory = node()
    file = directory / name
    if content is None:
        file.unlink()
    else:
        file.write_bytes(content if isinstance(content, bytes) else content.encode())
    wrong = [finding for finding in round_.examine(directory, {"system"}) if finding.level is Level.FAULT]
    assert [finding.check for finding in wrong] == [check]
    assert file.name in wrong[0].text


def test_a_camera_that_is_not_there_is_a_fault_with_a_remedy(node, capsys):
    directory = node()
    text = (directory / "node.toml").read_text()
    text = text.replace('"replay"\nreplay', '"v4l2"\nv4l2 = { device = "/dev/video97" }\nreplay')
    (directory / "node.toml").write_text(text)
    assert main(["doctor", "--config", str(directory), "--skip", "system"]) == 1
    out = capsys.readouterr().out
    assert "fault    camera: camera /dev/video97 does not exist" in out
    assert "remedy: check cable and driver" in out
    assert looked(directory, "camera")["camera"].level is Level.SKIPPED


def test_a_camera_driver_that_crashes_takes_only_its_own_process(node, monkeypatch, tmp_path):
    directory = node()
    (tmp_path / "sitecustomize.py").write_text(
        "import os, sys\nif 'sagnode.doctor.sight' in ' '.join(sys.orig_argv):\n    os.kill(os.getpid(), 11)\n"
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}")
    finding = looked(directory)["camera"]
    assert finding.level is Level.FAULT and "killed by signal 11" in finding.text


def test_beside_a_running_daemon_its_word_counts(node):
    directory = node()
    words = [sys.executable, "-m", "sagnode", "run", "--config", str(directory)]
    with subprocess.Popen(words, stderr=subprocess.DEVNULL) as daemon:
        try:
            until = time.monotonic() + 60
            while looked(directory, "camera")["daemon"].level is not Level.OK:  # it has shown a first reading
                assert daemon.poll() is None and time.monotonic() < until
                time.sleep(0.1)
        finally:
            daemon.terminate()
    assert looked(directory, "camera")["daemon"].text.startswith("none is running")


def test_the_journal_is_looked_at_and_not_touched(tmp_path):
    def journal():
        (finding,) = (f for f in place.check_state(tmp_path, running=False) if f.check == "journal")
        return finding

    assert journal().level is Level.SKIPPED
    file = tmp_path / "journal.sqlite"
    db = sqlite3.connect(file)
    db.execute("CREATE TABLE readings (fate TEXT)")
    db.executemany("INSERT INTO readings VALUES (?)", [("pending",), ("delivered",)])
    db.commit()
    assert journal().text.startswith("2 readings") and "1 of them not delivered" in journal().text
    db.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    db.close()
    assert journal().level is Level.FAULT and "later sagnode" in journal().text
    file.write_bytes(b"SQLite format 3\0" + b"x" * 4096)
    before = file.read_bytes()
    assert journal().level is Level.FAULT
    assert file.read_bytes() == before


def test_a_state_directory_that_cannot_be_used_is_a_fault(tmp_path):
    (tmp_path / "file").write_text("x")
    findings = list(place.check_state(tmp_path / "file", running=False))
    assert findings[0].level is Level.FAULT and "not a directory" in findings[0].text
    assert "/proc" in next(iter(place.check_state(place.Path("/proc/sagnode"), running=False))).text
    assert next(iter(place.check_state(tmp_path / "new" / "place", running=False))).level is Level.OK
