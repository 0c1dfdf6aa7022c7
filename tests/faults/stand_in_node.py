"""The real daemon with a stand-in for its worker, and with its patience shortened where a fault would cost minutes.

stand_in_node.py CONFIG WORDS      WORDS: JSON; worker: the worker's command line with {requests} and {replies};
                                     set: {"module.NAME": value}; clock: file with seconds to add to the time of day;
                                     names: no name server answers until this file is there
"""

import faulthandler
import json
import os
import socket
import sys
from datetime import UTC, datetime, timedelta
from importlib import import_module
from pathlib import Path

from sagnode.cli.main import main
from sagnode.daemon import node
from sagnode.daemon.clock import SystemClock

faulthandler.enable()
words = json.loads(sys.argv[2])


def stand_in(config, _album=None):
    def build(requests_fd, replies_fd, resume_after):
        places = {
            "{requests}": str(requests_fd),
            "{replies}": str(replies_fd),
            "{config}": str(config),
            "{parent}": str(os.getpid()),
        }
        return [places.get(word, word) for word in words["worker"]]

    return build


class SteppedClock(SystemClock):
    """The time of day with an offset that somebody else may change at any moment."""

    def now(self):
        try:
            offset = float(Path(words["clock"]).read_text() or 0)
        except (OSError, ValueError):
            offset = 0.0
        return datetime.now(UTC) + timedelta(seconds=offset)


def no_name_server(ask=socket.getaddrinfo):
    def getaddrinfo(*question, **more):
        if not Path(words["names"]).exists():
            raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")
        return ask(*question, **more)

    socket.getaddrinfo = getaddrinfo


if words.get("names"):
    no_name_server()
if words.get("worker"):
    node.command_line = stand_in
if words.get("clock"):
    node.SystemClock = SteppedClock
for name, value in words.get("set", {}).items():
    module, _, constant = name.rpartition(".")
    found = import_module(f"sagnode.{module}")
    assert hasattr(found, constant), name
    setattr(found, constant, value)
sys.exit(main(["run", "--config", sys.argv[1]]))
