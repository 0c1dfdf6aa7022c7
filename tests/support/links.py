"""Journal, outbox and link as the daemon has them, without the rest of it."""

from datetime import timedelta

from nodes import wait_for
from readings import START, fill

from sagnode.daemon.broker import Broker
from sagnode.daemon.journal import Journal
from sagnode.daemon.link import Link
from sagnode.daemon.outbox import Outbox
from sagnode.daemon.session import Terms

OFFLINE, LOST, ONLINE = b'{"state":"offline"}', b'{"state":"lost"}', b'{"state":"online"}'


class LinkedNode:
    def __init__(self, directory, *, inflight=5, backlog_per_s=2000.0, expiry_s=1e9, **broker):
        self.journal = Journal(directory / "journal.sqlite")
        self.outbox = Outbox(
            self.journal,
            inflight=inflight,
            backlog_per_s=backlog_per_s,
            expiry_s=expiry_s,
            now=lambda: START + timedelta(hours=1),
        )
        settings = {"host": "127.0.0.1", "client_id": "node-1", "keepalive_s": 5, **broker}
        self.link = Link(Terms(Broker(**settings), "t/1", lambda: ONLINE, LOST, 3600.0), self.outbox)
        self.link.start()

    def make(self, bursts):
        for _ in range(bursts):
            fill(self.journal, 1)
            self.link.wake()

    def wait_connected(self, seconds=10.0):
        wait_for(lambda: self.link.connected, seconds, lambda: self.link.state)

    def wait_state(self, text, seconds=10.0):
        wait_for(lambda: text in self.link.state, seconds, lambda: self.link.state)

    def close(self):
        self.link.stop(0.0, OFFLINE)
        self.journal.close()


def sequences(subscriber):
    return [r["sequence"] for r in subscriber.readings()]
