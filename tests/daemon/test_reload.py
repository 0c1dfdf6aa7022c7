"""A new configuration under a running node: whatever is in it, the node goes on."""

import signal

import pytest
from nodes import NO_CAMERA, SITE, start_daemon, status, wait_for, write_node

from sagnode.config.load import load_node
from sagnode.daemon.notify import Notifier, Watchdog
from sagnode.daemon.reload import Reloader

UNUSABLE = [
    ("interval_s = 0.5", "interval_s = 1e12", "schedule.interval_s: 1000000000000.0: must be"),
    ("[storage]", "[storage]\nkeep_days = 1e9", "storage.keep_days: 1000000000.0: must be"),
    ("deadline_s = 30", f"deadline_s = {'9' * 5000}", "thousands of digits"),
    ('state_dir = "state"', r'state_dir = "a\u0000b"', "storage.state_dir"),
]


def test_values_beyond_all_bounds_do_not_end_a_running_node(tmp_path):
    node = write_node(tmp_path, NO_CAMERA, "interval_s = 0.5\ndeadline_s = 30")
    good = node.read_text()
    process = start_daemon(node, tmp_path / "log")
    try:
        first = wait_for(lambda: status(tmp_path))["configuration_id"]
        for number, (old, new, _) in enumerate(UNUSABLE):
            node.write_text(good.replace(old, new))
            process.send_signal(signal.SIGHUP)
            wait_for(lambda n=number: (tmp_path / "log").read_text().count("reload refused") > n)
            made = status(tmp_path)["health"]["readings_made"]
            wait_for(lambda n=made: status(tmp_path)["health"]["readings_made"] > n)
        assert process.poll() is None
        assert status(tmp_path)["configuration_id"] == first
        assert "refused" in status(tmp_path)["health"]["configuration"]
        log = (tmp_path / "log").read_text()
        assert [says for _, _, says in UNUSABLE if says not in log] == []
        assert "Traceback" not in log
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("defect", [OverflowError("date value out of range"), RecursionError(), KeyError("x")])
def test_a_defect_in_reading_it_is_a_refusal_too(defect, caplog):
    def usable(_):
        raise defect

    loaded = load_node(SITE)
    watchdog = Watchdog(Notifier(None), None)
    reloader = Reloader(loaded, Notifier(None), watchdog, stopping=lambda: False, usable=usable)
    assert not reloader.accept()
    assert reloader.loaded is loaded
    assert f"reload refused: it cannot be read: unexpected {type(defect).__name__}" in caplog.text
    reloader.put_in_force()
    assert reloader.loaded is loaded
