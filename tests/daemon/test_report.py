"""What can be found out from outside about a daemon whose state directory is of no use."""

import json
import subprocess
import sys

import pytest
from nodes import start_daemon, wait_for, write_node

from sagnode.daemon.report import examine


@pytest.fixture
def read_only(tmp_path):
    place = tmp_path / "state"
    place.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4m", "none", place], check=False).returncode:
        pytest.skip("no tmpfs can be mounted here")
    (place / "lock").touch()  # as an earlier run leaves it
    subprocess.run(["mount", "-o", "remount,ro", place], check=True)
    yield place
    subprocess.run(["umount", "-l", place], check=True)


@pytest.mark.parametrize("with_lock", [True, False])
def test_a_daemon_whose_journal_is_in_memory_is_running(tmp_path, read_only, monkeypatch, with_lock):
    if not with_lock:
        subprocess.run(["mount", "-o", "remount,rw", read_only], check=True)
        (read_only / "lock").unlink()
        subprocess.run(["mount", "-o", "remount,ro", read_only], check=True)
    runtime = tmp_path / "run"
    runtime.mkdir()
    node = write_node(tmp_path, more='[mqtt]\nhost = "127.0.0.1"\nport = 1')
    process = start_daemon(node, tmp_path / "log", RUNTIME_DIRECTORY=str(runtime))
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(runtime))
    try:
        page = runtime / "status.json"
        wait_for(lambda: page.exists() and json.loads(page.read_text())["health"]["readings_made"] >= 3)
        report = examine(read_only)
        assert report["running"] is True
        assert not [text for text in report["problems"] if "not running" in text]
        assert [text for text in report["problems"] if "kept in memory" in text]
        assert report["status"]["health"]["outbox_depth"] >= 3  # of the journal that is in use
        said = subprocess.run(
            [sys.executable, "-m", "sagnode", "status", "--config", node], capture_output=True, text=True, check=False
        )
        assert "running, up" in said.stdout
    finally:
        process.kill()
        process.wait()
    assert examine(read_only)["running"] is False


def test_a_lock_in_the_runtime_directory_of_another_node_says_nothing(tmp_path, read_only, monkeypatch):
    runtime, other = tmp_path / "run", tmp_path / "other"
    runtime.mkdir()
    other.mkdir()
    node = write_node(tmp_path)
    process = start_daemon(node, tmp_path / "log", RUNTIME_DIRECTORY=str(runtime))
    monkeypatch.setenv("RUNTIME_DIRECTORY", str(runtime))
    try:
        wait_for((runtime / "status.json").exists)
        assert examine(read_only)["running"] is True
        assert examine(other)["running"] is False
    finally:
        process.kill()
        process.wait()
