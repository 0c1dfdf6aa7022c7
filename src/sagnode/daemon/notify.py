"""Word to systemd (sd_notify), and a watchdog that is fed by progress.

Protocol: https://www.freedesktop.org/software/systemd/man/latest/sd_notify.html
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Callable, Mapping


class Notifier:
    """Sends state to the service manager; without one it does nothing.

    Args:
        address: ``$NOTIFY_SOCKET``: a path, or a name in the abstract namespace that begins with ``@``.
    """

    def __init__(self, address: str | None) -> None:
        self._socket: socket.socket | None = None
        self._address = ""
        if address and address[0] in "/@":
            self._address = "\0" + address[1:] if address[0] == "@" else address
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    @property
    def present(self) -> bool:
        """Whether a service manager listens."""
        return self._socket is not None

    def tell(self, *assignments: str) -> None:
        """Send lines such as ``READY=1``; a manager that does not listen is no concern of ours."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto("\n".join(assignments).encode(), self._address)

    def ready(self, status: str) -> None:
        """Start-up, or a reload, is finished."""
        self.tell("READY=1", f"STATUS={_one_line(status)}")

    def status(self, text: str) -> None:
        """One line for ``systemctl status``."""
        self.tell(f"STATUS={_one_line(text)}")

    def reloading(self) -> None:
        """A new configuration is being read."""
        self.tell("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """The end has begun."""
        self.tell("STOPPING=1", "STATUS=stopping")

    def patience(self, seconds: float) -> None:
        """Ask for more time to start or to stop."""
        self.tell(f"EXTEND_TIMEOUT_USEC={int(seconds * 1e6)}")


class Watchdog:
    """Feeds systemd's watchdog for as long as promises are kept.

    Whoever waits says first by when it will have made progress. While that time has not come, :meth:`beat` feeds the
    watchdog; afterwards it does not, and systemd ends a daemon that is alive but goes nowhere.

    Args:
        notifier: the way to systemd.
        period_s: time after which systemd loses patience, None without a watchdog.
    """

    def __init__(
        self, notifier: Notifier, period_s: float | None, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._notifier = notifier
        self._every_s = None if period_s is None else period_s / 3
        self._monotonic = monotonic
        self._promised_until = float("-inf")
        self._fed_at = float("-inf")

    @property
    def kept(self) -> bool:
        """Whether the last promise still holds."""
        return self._monotonic() <= self._promised_until

    def starve(self) -> None:
        """Feed it no more, whatever is promised: the last resort, for the system to start all anew."""
        self._every_s = None

    def promise(self, seconds: float) -> None:
        """Progress comes within so many seconds; the last promise was kept."""
        self._promised_until = self._monotonic() + seconds
        self.beat()

    def beat(self) -> None:
        """Feed the watchdog, if it is due and the promise holds."""
        now = self._monotonic()
        if self._every_s is not None and now <= self._promised_until and now - self._fed_at >= self._every_s:
            self._fed_at = now
            self._notifier.tell("WATCHDOG=1")


def watchdog_period_s(environment: Mapping[str, str], pid: int) -> float | None:
    """``$WATCHDOG_USEC`` in seconds where it is meant for this process, else None."""
    try:
        if environment.get("WATCHDOG_PID", str(pid)) != str(pid):
            return None
        period = int(environment["WATCHDOG_USEC"])
    except (KeyError, ValueError):
        return None
    return period / 1e6 if period > 0 else None


def from_environment() -> Notifier:
    """The notifier that ``$NOTIFY_SOCKET`` names."""
    return Notifier(os.environ.get("NOTIFY_SOCKET"))


def _one_line(text: str) -> str:
    return " ".join(text.split())
