"""The ladder of recovery, with the machine's uptime handed in and its memory in a real file."""

import json

import pytest

from sagnode.daemon.ladder import Ladder, Rung, Steps
from sagnode.quality import Cause, Reason

STEPS = Steps(restart_after_s=600, restarts_before_reboot=2, reboot=True, reboot_wait_h=1.0)
HANGS = Reason(Cause.DEADLINE, "no reading")


class Machine:
    """Boots, starts services, and lets time pass."""

    def __init__(self, directory, steps=STEPS):
        self.directory, self.steps, self.boot, self.uptime = directory, steps, 0, 0.0
        self.start()

    def start(self):
        self.ladder = Ladder(
            self.directory / "recovery.json",
            self.steps,
            f"boot-{self.boot}",
            self.directory / "reboot-wanted",
            uptime=lambda: self.uptime,
        )

    def reboot(self):
        self.boot, self.uptime = self.boot + 1, 0.0
        self.start()

    def fail_until_something_happens(self, reason=HANGS, at_most_s=2 * 86400):
        until = self.uptime + at_most_s
        while self.uptime < until:
            rung = self.ladder.failed(reason)
            if rung is not Rung.STAY:
                return rung
            self.uptime += 60
        return Rung.STAY


@pytest.fixture
def machine(tmp_path):
    return lambda steps=STEPS: Machine(tmp_path, steps)


def test_first_the_service_then_the_machine(machine, tmp_path):
    m = machine()
    for _ in range(2):
        assert m.fail_until_something_happens() is Rung.RESTART
        m.start()
    assert m.fail_until_something_happens() is Rung.REBOOT
    assert m.uptime >= 3600  # it has been up for an hour by then
    assert "without a reading" in (tmp_path / "reboot-wanted").read_text()
    assert "unfed" in m.ladder.state


def test_reboots_that_do_not_help_become_rare(machine):
    m = machine()
    waits = []
    for _ in range(7):
        while m.fail_until_something_happens() is Rung.RESTART:
            m.start()
        waits.append(round(m.uptime / 3600))
        m.reboot()
    assert waits == [1, 2, 4, 8, 16, 24, 24]


def test_a_reading_ends_it_all(machine, tmp_path):
    m = machine()
    m.fail_until_something_happens()
    m.start()
    assert m.ladder.state == "1 restarts of the service without a reading since"
    m.ladder.answered()
    assert m.ladder.state == "ok"
    assert json.loads((tmp_path / "recovery.json").read_text())["restarts"] == 0
    assert m.ladder.failed(HANGS) is Rung.STAY


def test_one_reading_in_between_starts_the_count_anew(machine):
    m = machine()
    for _ in range(100):
        assert m.ladder.failed(HANGS) is Rung.STAY
        m.uptime += 300
        m.ladder.answered()


@pytest.mark.parametrize("cause", [Cause.DARK, Cause.BAD_CALIBRATION, Cause.BAD_FRAME])
def test_what_a_fresh_start_cannot_mend_does_not_climb(machine, cause):
    assert machine().fail_until_something_happens(Reason(cause, "so it is")) is Rung.STAY


def test_rare_readings_must_have_failed_three_times(machine):
    m = machine()
    rungs = []
    for _ in range(3):
        rungs.append(m.ladder.failed(HANGS))
        m.uptime += 10_000
    assert rungs == [Rung.STAY, Rung.STAY, Rung.RESTART]


def test_what_cannot_be_remembered_is_not_done(machine, tmp_path):
    m = machine()
    (tmp_path / "recovery.json.part").mkdir()  # refuses like a disk
    assert m.fail_until_something_happens() is Rung.STAY


def test_a_memory_that_cannot_be_understood_is_none(machine, tmp_path):
    for text in ("", "[]", "{}", '{"boot_id": 3, "restarts": "x", "reboots": 0}', "\x00\xff"):
        (tmp_path / "recovery.json").write_text(text)
        assert machine().ladder.state == "ok"


def test_no_reboot_where_it_is_not_wanted(machine, tmp_path):
    m = machine(Steps(restart_after_s=600, restarts_before_reboot=1, reboot=False, reboot_wait_h=1.0))
    assert m.fail_until_something_happens() is Rung.RESTART
    m.start()
    assert m.fail_until_something_happens() is Rung.STAY
    assert not (tmp_path / "reboot-wanted").exists()
