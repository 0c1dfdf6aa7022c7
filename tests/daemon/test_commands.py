"""Commands as bytes from anywhere: what is heard, what is answered with an error, what is ignored."""

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import START

from sagnode.daemon.commands import WAITING_MAX, Inbox
from sagnode.exchange import COMMAND_MAX_BYTES, MeasureCommand, ReplyMessage, ResendCommand


class Asker:
    def __init__(self, per_minute=60):
        self.time, self.replies, self.correlations = 0.0, [], []
        self.inbox = Inbox(per_minute, now=lambda: START, monotonic=lambda: self.time)
        self.inbox.answer_by(self.keep)

    def keep(self, topic, payload, *, content_type, correlation):
        assert (topic, content_type) == ("reply", "application/json")
        self.replies.append(ReplyMessage.model_validate_json(payload))
        self.correlations.append(correlation)

    def ask(self, payload, *, retained=False, correlation=None):
        text = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        self.inbox.receive(text, retained=retained, correlation=correlation)


@pytest.fixture
def asker():
    return Asker()


def test_a_command_waits_for_the_loop_and_its_reply_bears_both_correlations(asker):
    asker.ask({"command": "measure", "correlation": "7"}, correlation=b"\x00\xff")
    asked = asker.inbox.take()
    assert asked.command == MeasureCommand(command="measure", correlation="7")
    asker.inbox.answer(asked, sequences={"L1": 5})
    (reply,) = asker.replies
    assert (reply.ok, reply.command, reply.correlation, reply.sequences) == (True, "measure", "7", {"L1": 5})
    assert asker.correlations == [b"\x00\xff"]
    assert asker.inbox.take() is None


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "JSON"),
        (b"measure", "JSON"),
        (b"\xff\xfe", "JSON"),
        (b"[]", "object"),
        ({"command": "reboot"}, "'measure', 'picture', 'resend'"),
        ({"command": "measure", "shell": "rm"}, "shell"),
        ({"command": "picture"}, "conductor"),
        ({"command": "picture", "conductor": "../../etc/passwd"}, "conductor"),
        ({"command": "resend", "from_sequence": 0}, "from_sequence"),
        ({"command": "resend", "from_sequence": 1e400}, "from_sequence"),
        ({"command": "resend", "from_sequence": True}, "from_sequence"),
        ({"command": "resend", "from_sequence": 1, "to_sequence": True}, "to_sequence"),
        ({"command": "measure", "correlation": "x" * 200}, "correlation"),
        (b'{"command":"measure","correlation":"' + b"x" * COMMAND_MAX_BYTES + b'"}', f"{COMMAND_MAX_BYTES} at most"),
    ],
)
def test_what_is_no_command_is_answered_with_an_error_and_nothing_else(asker, payload, words):
    asker.ask(payload, correlation=b"c")
    (reply,) = asker.replies
    assert not reply.ok
    assert words in reply.error
    assert asker.correlations == [b"c"]
    assert asker.inbox.take() is None


def test_a_refusal_too_bears_the_correlation_of_its_payload_where_there_is_one(asker):
    asker.ask({"command": "reboot", "correlation": "8"})
    asker.ask({"command": "reboot", "correlation": ["8"]})
    asker.ask(b'{"command":"reboot","correlation":"\\ud800"}')  # half a pair: text in JSON, but none that can be sent
    assert [r.correlation for r in asker.replies] == ["8", None, None]


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_no_bytes_do_harm(payload):
    asker = Asker()
    asker.ask(payload)
    assert asker.inbox.take() is None
    assert [r.ok for r in asker.replies] == [False]


def test_a_retained_command_is_ignored(asker):
    asker.ask({"command": "measure"}, retained=True)
    assert asker.inbox.take() is None
    assert asker.replies == []


def test_too_many_are_refused_and_a_flood_is_not_even_answered():
    asker = Asker(per_minute=6)
    for _ in range(100):
        asker.ask({"command": "resend", "from_sequence": 1})
    heard = []
    while (asked := asker.inbox.take()) is not None:
        heard.append(asked)
    assert len(heard) == 6
    assert len(asker.replies) == 6
    assert "more than 6 commands a minute" in asker.replies[0].error
    asker.time += 20
    asker.ask({"command": "resend", "from_sequence": 3, "to_sequence": 4})
    assert asker.inbox.take().command == ResendCommand(command="resend", from_sequence=3, to_sequence=4)


def test_while_the_loop_is_busy_only_a_few_wait(asker):
    for _ in range(WAITING_MAX + 1):
        asker.ask({"command": "measure"})
    assert [r.ok for r in asker.replies] == [False]
    assert "wait already" in asker.replies[0].error
