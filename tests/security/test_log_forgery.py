"""Nobody outside writes lines into the log or signs onto a technician's screen."""

import json
import logging
from datetime import UTC, datetime

import pytest

from sagnode.daemon.commands import Inbox
from sagnode.exchange import CORRELATION_MAX


@pytest.mark.parametrize(
    "command",
    [
        {"command": "measure", "a\n<3>the broker's certificate is fine": 1},
        {"command": "measure", "\x1b[2J\x1b[31mall is well": 1},
        {"command": "picture", "conductor": "L1\n<0>fire"},
        {"command": "measure\r\nERROR forged"},
        {"command": "measure", "correlation": "x\n" * CORRELATION_MAX},
        {"command": "measure", "\u202eesrever": 1},
    ],
)
def test_a_refused_command_leaves_one_printable_line(caplog, command):
    sent = []
    inbox = Inbox(60, now=lambda: datetime.now(UTC))
    inbox.answer_by(lambda topic, payload, **_: sent.append(json.loads(payload)))
    with caplog.at_level(logging.DEBUG):
        inbox.receive(json.dumps(command).encode(), retained=False, correlation=None)
    assert len(caplog.records) == 1
    assert caplog.records[0].getMessage().isprintable()
    assert sent[0]["error"].isprintable()
