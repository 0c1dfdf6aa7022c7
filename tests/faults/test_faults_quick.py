"""A few of the campaign's faults, for every run of the tests; `make faults` does all of them, in their hundreds."""

import signal
import sqlite3
import time

import campaign
import pytest
from brokers import MOSQUITTO
from campaign import Campaign
from rig import Rig
from section_worker import GROUPS
from volatile_disk import available

QUICK = [kind for kinds in GROUPS.values() for kind in kinds if "hang" not in kind and kind != "stop"]

pytestmark = pytest.mark.skipif(MOSQUITTO is None, reason="mosquitto is not installed")


def test_worker_daemon_link_and_broker_fail_and_nothing_is_lost(tmp_path):
    with Rig(tmp_path / "node", QUICK) as rig:
        rig.start()
        rig.wait_good(12)
        for where in ("before-puback", "inside-publish"):
            rig.witness.cut(where)
            rig.wait_for(lambda: rig.witness._cut is None)
        rig.broker.signal(signal.SIGSTOP)
        rig.wait_good(2)
        rig.broker.signal(signal.SIGCONT)
        for _ in range(2):
            rig.kill()
            rig.start()
            rig.wait_good(2)
        rig.last_run()
        books = rig.books()
    assert books.made > 60
    assert (books.lost, books.false, books.remarks) == (0, 0, [])
    assert books.in_flight <= rig.kills


def test_a_disk_that_forgets_what_was_not_flushed_loses_no_reading(tmp_path):
    if available():
        pytest.skip(available())
    import section_power

    campaign = Campaign(4 / section_power.CUTS, 1, tmp_path)
    (line,) = section_power.run(campaign)
    assert line.times == 4
    assert line.verdict() == []


def test_a_damaged_journal_gives_back_what_is_whole(tmp_path):
    import section_journal

    for line in section_journal.run(Campaign(10 / section_journal.COUNT, 2, tmp_path)):
        assert line.verdict() == []


def test_what_is_mutilated_is_read_or_refused_in_words(tmp_path):
    import section_fuzz

    for line in section_fuzz.run(Campaign(0.001, 3, tmp_path)):
        assert line.verdict() == []
        assert line.uncaught == 0
        assert line.refused > 0


def test_every_section_is_in_one_lane():
    assert sorted((*campaign.LONGEST_FIRST, *campaign.ALONE)) == sorted(campaign.SECTIONS)


def test_missing_numbers_are_counted_however_far_they_leapt(tmp_path):
    with Rig(tmp_path / "node") as rig:
        rig.start()
        rig.wait_good(2)
        rig.last_run()
        with sqlite3.connect(rig.state / "journal.sqlite") as db:
            db.execute("UPDATE readings SET sequence = 10000000000 WHERE sequence = 3")
        books = rig.books()
    assert books.lost == 10**10 - books.made + 1  # the moved one was never delivered under its new number


def test_the_books_see_a_lost_a_repeated_and_a_false_reading(tmp_path):
    """The campaign itself can fail."""
    with Rig(tmp_path / "node") as rig:
        rig.start()
        rig.wait_good(3)
        rig.last_run()
        time.sleep(0.2)
        measured = [m for m in rig.subscriber.messages if "/measurement/" in m.topic]
        rig.subscriber.messages.remove(measured[0])
        rig.subscriber.messages.append(measured[1])
        measured[2].payload = measured[2].payload.replace(b'"landmarks_used":', b'"landmarks_used":9')
        books = rig.books()
    assert (books.lost, books.repeated, books.false) == (1, 1, 1)
