"""sd_notify on a real datagram socket, and a watchdog that is fed by progress only."""

import socket

import pytest

from sagnode.daemon.notify import Notifier, Watchdog, watchdog_period_s


@pytest.fixture(params=["path", "abstract"])
def manager(request, tmp_path):
    address = str(tmp_path / "notify") if request.param == "path" else f"@sagnode-test-{tmp_path.name}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind("\0" + address[1:] if address[0] == "@" else address)
        listener.settimeout(2)
        yield address, listener


def test_words_arrive(manager):
    address, listener = manager
    notifier = Notifier(address)
    notifier.ready("all\nwell")
    notifier.status("3 readings")
    notifier.stopping()
    assert listener.recv(1000) == b"READY=1\nSTATUS=all well"
    assert listener.recv(1000) == b"STATUS=3 readings"
    assert listener.recv(1000).startswith(b"STOPPING=1")


@pytest.mark.parametrize("address", [None, "", "relative/name", "/nowhere/socket"])
def test_without_a_manager_nothing_happens(address):
    Notifier(address).ready("x")


def test_a_manager_that_does_not_read_blocks_nobody(manager):
    address, _ = manager
    notifier = Notifier(address)
    for _ in range(10_000):
        notifier.status("x" * 100)


def test_the_watchdog_is_fed_while_promises_hold_and_not_longer(manager):
    address, listener = manager
    listener.settimeout(0.05)
    now = [0.0]
    watchdog = Watchdog(Notifier(address), 30.0, monotonic=lambda: now[0])

    def fed():
        try:
            return listener.recv(100) == b"WATCHDOG=1"
        except TimeoutError:
            return False

    watchdog.beat()
    assert not fed(), "nobody has promised anything"
    watchdog.promise(60.0)
    assert fed()
    now[0] = 5.0
    watchdog.beat()
    assert not fed(), "not due yet"
    now[0] = 11.0
    watchdog.beat()
    assert fed()
    now[0] = 61.0
    watchdog.beat()
    assert not fed(), "the promise was broken"
    assert not watchdog.kept


def test_watchdog_period():
    assert watchdog_period_s({"WATCHDOG_USEC": "30000000"}, 7) == 30.0
    assert watchdog_period_s({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "7"}, 7) == 30.0
    assert watchdog_period_s({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": "8"}, 7) is None
    assert watchdog_period_s({}, 7) is None
    assert watchdog_period_s({"WATCHDOG_USEC": "x"}, 7) is None
    assert watchdog_period_s({"WATCHDOG_USEC": "0"}, 7) is None
