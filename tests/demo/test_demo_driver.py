"""The demonstration itself on two frames, with each broker, and interrupted."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import time
from importlib.resources import files
from pathlib import Path

import pytest

from sagnode.cli.main import main
from sagnode.demo.broker import EmbeddedBroker

SITE = Path(str(files("sagnode.demo") / "site"))
FRAMES = sorted((SITE / "frames").glob("*T1[2-3]*.jpg"))
MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
PNG = b"\x89PNG"


@pytest.fixture
def site(tmp_path):
    directory = tmp_path / "site"
    (directory / "frames").mkdir(parents=True)
    for file in ("node.toml", "span.toml", "camera.yaml", "reference.jpg"):
        shutil.copy(SITE / file, directory)

    def with_frames(count):
        for frame in FRAMES[:count]:
            shutil.copy(frame, directory / "frames")
            shutil.copy(frame.with_suffix(".json"), directory / "frames")
        return directory

    return with_frames


@pytest.mark.skipif(len(FRAMES) < 2, reason="the demonstration's frames are not there")
@pytest.mark.parametrize("broker", ["mosquitto", "amqtt"])
def test_two_frames_from_end_to_end(tmp_path, site, capsys, broker):
    if broker == "mosquitto" and MOSQUITTO is None:
        pytest.skip("mosquitto is not installed")
    out = tmp_path / "out"
    assert main(["demo", "--site", str(site(2)), "--out", str(out), "--broker", broker]) == 0
    said = capsys.readouterr().out
    assert said.count("12:00  L") == 3
    assert "6 in the journal, 0 lost, 0 repeated" in said
    assert "RMSE" in said
    assert (out / "day.png").read_bytes().startswith(PNG)
    assert (out / "overlay.png").read_bytes().startswith(PNG)
    assert "Traceback" not in (out / "daemon.log").read_text()


def test_without_frames_it_ends_with_a_clear_line(tmp_path, site, capsys):
    assert main(["demo", "--site", str(site(0)), "--out", str(tmp_path / "out")]) == 1
    assert "frames" in capsys.readouterr().err


@pytest.mark.skipif(len(FRAMES) < 24, reason="the demonstration's frames are not there")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_it_ends_all_its_children(tmp_path, site, number):
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, "-m", "sagnode", "demo", "--site", str(site(24)), "--out", str(out)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    until = time.monotonic() + 20
    while len(_naming(out)) < 3:  # broker or daemon, and worker
        assert time.monotonic() < until
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(number)
    assert process.wait(20) == 130
    time.sleep(0.2)
    assert _naming(out) == []


def _naming(path):
    found = []
    for command in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            if str(path).encode() in command.read_bytes():
                found.append(command.parent.name)
    return found


@pytest.mark.parametrize("kind", ["mosquitto", "amqtt"])
def test_a_broker_is_gone_afterwards(tmp_path, kind):
    if kind == "mosquitto" and MOSQUITTO is None:
        pytest.skip("mosquitto is not installed")
    with EmbeddedBroker(tmp_path, kind) as broker:
        pid = broker._process.pid
        assert Path(f"/proc/{pid}").exists()
        assert broker.mqtt5 is (kind == "mosquitto")
    assert not Path(f"/proc/{pid}").exists()
