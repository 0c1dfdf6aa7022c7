"""Order, rate and memory of the outbox, on a real journal, with hands in place of the network."""

import json
from datetime import timedelta

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from readings import START, fill

from sagnode.daemon.journal import Journal
from sagnode.daemon.outbox import SET_ASIDE_S, Outbox


class Hands:
    def __init__(self, tmp_path, **options):
        self.journal = Journal(tmp_path / "journal.sqlite")
        self.seconds = 0.0
        self.wall = START + timedelta(hours=1)
        defaults = {"inflight": 5, "backlog_per_s": 1e9, "expiry_s": 1e9}
        self.outbox = Outbox(
            self.journal, now=lambda: self.wall, monotonic=lambda: self.seconds, **{**defaults, **options}
        )

    def take(self):
        self.seconds += 0.001
        return self.outbox.take()

    def drain(self):
        sent = []
        while batch := self.take():
            sent += batch
            for outgoing in batch:
                self.outbox.acknowledged(outgoing.sequence)
            self.outbox.settle()
        return sent


@pytest.fixture
def hands(tmp_path):
    return lambda **options: Hands(tmp_path, **options)


def test_newest_first_then_the_rest_in_order_as_backfill(hands):
    h = hands(inflight=100)
    fill(h.journal, 4)
    sent = h.drain()
    assert [o.sequence for o in sent] == [10, 11, 12, 1, 2, 3, 4, 5, 6, 7, 8, 9]
    assert [o.backfill for o in sent] == [False] * 3 + [True] * 9
    message = json.loads(sent[3].payload)
    assert message["backfill"] is True
    assert message["published_at"].startswith("2026-06-01T01:00")
    assert message["sag_m"] == 8.0
    assert h.journal.backlog().depth == 0


def test_never_more_than_inflight_on_the_wire(hands):
    h = hands(inflight=5)
    fill(h.journal, 10)
    assert len(h.take()) == 5
    assert h.take() == []
    h.outbox.acknowledged(28)
    assert len(h.take()) == 1
    assert h.outbox.on_the_wire == 5


def test_what_was_acknowledged_while_the_journal_was_read_is_not_sent_again(hands):
    h = hands(inflight=4)
    fill(h.journal, 2)
    sent = h.take()
    for outgoing in sent:
        h.outbox.acknowledged(outgoing.sequence)  # and only in memory yet
    sent += h.take()
    h.outbox.settle()
    fill(h.journal, 1)
    for outgoing in sent[4:]:
        h.outbox.acknowledged(outgoing.sequence)
    sent += h.drain()
    assert sorted(outgoing.sequence for outgoing in sent) == list(range(1, 10))


def test_a_fresh_reading_passes_the_backlog(hands):
    h = hands(inflight=4)
    fill(h.journal, 50)
    for outgoing in h.take():
        h.outbox.acknowledged(outgoing.sequence)
    fill(h.journal, 1)
    assert [o.sequence for o in h.take()][:3] == [151, 152, 153]


def test_everything_is_sent_once_whatever_comes_between(hands):
    h = hands(inflight=3)
    fill(h.journal, 3)
    seen = []
    for round_ in range(200):
        batch = h.take()
        seen += [o.sequence for o in batch]
        for outgoing in batch[: 2 if round_ % 3 else 3]:
            h.outbox.acknowledged(outgoing.sequence)
        if round_ % 4 == 0:
            h.outbox.settle()
        if round_ < 40:
            fill(h.journal, 1)
        for outgoing in batch[2 if round_ % 3 else 3 :]:
            h.outbox.acknowledged(outgoing.sequence)
    h.outbox.settle()
    assert sorted(seen) == list(range(1, 130))
    assert h.journal.backlog().depth == 0


def test_a_newest_that_was_overtaken_before_it_was_sent_is_not_forgotten(hands):
    h = hands(inflight=1)
    fill(h.journal, 2, ("L1",))
    first = h.take()
    assert [o.sequence for o in first] == [2]
    fill(h.journal, 3, ("L1",))
    h.outbox.acknowledged(2)
    assert [o.sequence for o in h.drain()] == [5, 1, 3, 4]


def test_after_a_lost_link_what_was_on_the_wire_is_owed_again(hands):
    h = hands()
    fill(h.journal, 2)
    taken = h.take()
    h.outbox.acknowledged(taken[0].sequence)
    h.outbox.link_lost(by_broker=False)
    rest = {o.sequence for o in h.drain()}
    assert rest == {1, 2, 3, 4, 5, 6} - {taken[0].sequence}


def test_the_backlog_keeps_its_rate_and_fresh_ones_do_not_count(hands):
    h = hands(inflight=1000, backlog_per_s=10.0)
    fill(h.journal, 100)
    sent = 0
    for _ in range(100):
        h.seconds += 0.05
        batch = h.outbox.take()
        sent += sum(o.backfill for o in batch)
        for o in batch:
            h.outbox.acknowledged(o.sequence)
    assert 48 <= sent <= 54
    assert 0.0 < h.outbox.wait_s() <= 0.1


def test_an_expired_newest_is_sent_as_backfill(hands):
    h = hands(expiry_s=60)
    fill(h.journal, 1, ("L1",))
    h.wall = START + timedelta(days=2)
    assert [o.backfill for o in h.take()] == [True]


def test_a_refused_reading_is_set_aside_and_tried_again_later(hands):
    h = hands()
    fill(h.journal, 2, ("L1",))
    h.outbox.take()
    h.outbox.refused(1, "quota exceeded")
    h.outbox.acknowledged(2)
    assert h.drain() == []
    assert h.outbox.set_aside == 1
    h.seconds += SET_ASIDE_S + 1
    assert [o.sequence for o in h.drain()] == [1]
    assert h.outbox.set_aside == 0


def test_a_refused_reading_that_left_the_journal_is_not_counted_for_ever(hands):
    h = hands()
    fill(h.journal, 2, ("L1",))
    h.take()
    h.outbox.acknowledged(2)
    h.outbox.refused(1, "quota exceeded")
    h.drain()
    h.journal.mark_delivered([1], h.wall)  # owed no more, as after pruning
    h.seconds += SET_ASIDE_S + 1
    assert h.drain() == []
    assert h.outbox.set_aside == 0


def test_a_poison_message_does_not_block_the_rest(hands):
    h = hands(inflight=5)
    fill(h.journal, 4)
    delivered = set()
    for _ in range(60):  # connections; the broker hangs up whenever it meets reading 2
        while batch := h.take():
            numbers = [o.sequence for o in batch]
            if 2 in numbers:
                break
            for number in numbers:
                h.outbox.acknowledged(number)
                delivered.add(number)
            h.outbox.settle()
        h.outbox.link_lost(by_broker=True)
    assert delivered == set(range(1, 13)) - {2}
    assert h.outbox.set_aside == 1


def test_acknowledgements_survive_a_disk_that_refuses(hands):
    h = hands()
    fill(h.journal, 1)
    for outgoing in h.take():
        h.outbox.acknowledged(outgoing.sequence)
    assert h.outbox.unwritten == 3
    assert h.take() == []
    h.outbox.settle()
    assert h.outbox.unwritten == 0
    assert h.journal.backlog().depth == 0


@given(
    st.lists(st.sampled_from(["make", "make", "take", "take", "answer", "settle", "refuse", "lose"]), max_size=60),
    st.integers(1, 4),
)
@settings(max_examples=60, deadline=None)
def test_whatever_the_order_of_events_every_reading_is_delivered_once(tmp_path_factory, events, inflight):
    h = Hands(tmp_path_factory.mktemp("outbox"), inflight=inflight)
    wire, delivered = [], []
    for event in events:
        if event == "make":
            fill(h.journal, 1, ("L1", "L2"))
        elif event == "take":
            wire += [o.sequence for o in h.take()]
            assert len(wire) <= inflight
        elif event == "answer" and wire:
            delivered.append(wire.pop(0))
            h.outbox.acknowledged(delivered[-1])
        elif event == "refuse" and wire:
            h.outbox.refused(wire.pop(), "no")
        elif event == "settle":
            h.outbox.settle()
        elif event == "lose":
            h.outbox.link_lost(by_broker=True)
            wire.clear()
    for sequence in wire:
        delivered.append(sequence)
        h.outbox.acknowledged(sequence)
    delivered += [o.sequence for o in h.drain()]
    h.seconds += SET_ASIDE_S + 1
    delivered += [o.sequence for o in h.drain()]
    assert sorted(delivered) == list(range(1, h.journal.next_sequence))
    h.outbox.settle()
    assert h.outbox.drained()
    h.journal.close()
