"""What is sent again: only what is in the journal, in parts, and marked as owed by the journal itself."""

import pytest
from readings import START, fill

from sagnode.daemon import dialogue
from sagnode.daemon.alarms import Alarms, Debounce
from sagnode.daemon.commands import Inbox
from sagnode.daemon.dialogue import Dialogue
from sagnode.daemon.journal import Journal
from sagnode.exchange import ReplyMessage
from sagnode.message import Identity


@pytest.fixture
def asked(tmp_path):
    """Ten bursts of three, all delivered; asking returns the reply."""
    journal = Journal(tmp_path / "journal.sqlite")
    fill(journal, 10)
    journal.mark_delivered(range(1, 31), START)
    replies = []
    inbox = Inbox(600, now=lambda: START)
    inbox.answer_by(lambda topic, payload, **_: replies.append(ReplyMessage.model_validate_json(payload)))
    identity = Identity(utility="u", line="l", span="s", unit="n")
    alarms = Alarms(identity, {}, Debounce(2, 3), file=tmp_path / "alarms.json", publish=lambda *_: None)
    talk = Dialogue(alarms, inbox, journal=journal, link=None, conductors=["L1"], picture_on_alarm=False)

    def ask(text):
        inbox.receive(text.encode(), retained=False, correlation=None)
        assert not talk.wanted()
        return replies[-1], [row.sequence for row in journal.pending(0, 100)]

    return ask


def test_a_part_and_all_from_a_number_on(asked):
    reply, owed = asked('{"command": "resend", "from_sequence": 4, "to_sequence": 6}')
    assert (reply.resent, owed) == (3, [4, 5, 6])
    reply, owed = asked('{"command": "resend", "from_sequence": 5}')
    assert (reply.resent, owed) == (24, list(range(4, 31)))  # two of them are owed already


@pytest.mark.parametrize("words", ['"from_sequence": 31', '"from_sequence": 9, "to_sequence": 8'])
def test_nothing_is_an_error(asked, words):
    reply, owed = asked(f'{{"command": "resend", {words}}}')
    assert not reply.ok
    assert "the newest reading is 30" in reply.error
    assert owed == []


def test_too_many_at_a_time_are_refused(asked, monkeypatch):
    monkeypatch.setattr(dialogue, "RESEND_MAX", 10)
    reply, owed = asked('{"command": "resend", "from_sequence": 1, "to_sequence": 11}')
    assert "11 readings; 10 at most at a time" in reply.error
    assert owed == []
    assert asked('{"command": "resend", "from_sequence": 1, "to_sequence": 10}')[0].ok
