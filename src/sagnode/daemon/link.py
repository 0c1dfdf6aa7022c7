"""The link to the broker: one thread that connects, hands over what the outbox gives, and listens for PUBACKs.

Every connection gets a client of its own: paho keeps unacknowledged messages in memory and sends them all at once
after a reconnection, without regard to its own limit. What was on the wire when a link broke is simply owed again by
the outbox, which is the journal. A new client also reads passwords and certificates anew.

The daemon's loop never waits for this thread, except at its end and then for a bounded time.
"""

from __future__ import annotations

import logging
import random
import threading
import time
from datetime import datetime

from sagnode.daemon.logs import Seldom
from sagnode.daemon.mailbox import About, Farewell, Mailbox, Note
from sagnode.daemon.outbox import Outbox
from sagnode.daemon.session import FAREWELL_S, LinkLostError, Session, Terms

log = logging.getLogger(__name__)

BACKOFF_MAX_S = 30.0
_STABLE_S = 10.0


class Link:
    """Keeps the connection and empties the outbox.

    Args:
        terms: broker, topics and the words for ``status``.
        outbox: what to send; only the link's thread touches it.
    """

    def __init__(self, terms: Terms, outbox: Outbox) -> None:
        self._terms = terms
        self._outbox = outbox
        self._mailbox = Mailbox()
        self._complaints = Seldom(log)
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)
        self.state = "connecting"
        """One line for health and status."""
        self.connected = False
        self._connected_at = float("inf")
        self._failures = 0
        self._told = ""
        """Why the broker hung up the last time that it said so, while it does so again and again."""

    def start(self) -> None:
        """Begin to connect."""
        self._thread.start()

    def wake(self) -> None:
        """There is something new in the journal."""
        self._mailbox.nudge()

    def show(self, topic: str, payload: bytes) -> None:
        """Publish a retained document below the prefix; only the newest of each topic is kept."""
        self._mailbox.put(topic, payload)
        self._mailbox.nudge()

    def certificate_ends_at(self) -> datetime | None:
        """End of the client certificate that the next connection will use."""
        return self._terms.broker.certificate_ends_at()

    def say(
        self, topic: str, payload: bytes, *, content_type: str, correlation: bytes | None = None, about: About = ()
    ) -> None:
        """Publish once, not retained, below the prefix; lost where there is no connection for long.

        Args:
            topic: below the prefix.
            payload: of the message.
            content_type: of the payload, for MQTT 5.
            correlation: MQTT 5 correlation data.
            about: MQTT 5 user properties.
        """
        self._mailbox.drop(Note(topic, payload, content_type, correlation, about))
        self._mailbox.nudge()

    def look_again(self) -> None:
        """Readings in the journal are owed once more."""
        self._mailbox.look_again = True
        self._mailbox.nudge()

    @property
    def packet_max(self) -> int:
        """Largest packet that the broker takes, bytes."""
        return self._mailbox.packet_max

    @property
    def set_aside(self) -> int:
        """Readings that the broker would not take; they are tried again after an hour."""
        return self._outbox.set_aside

    @property
    def delivery(self) -> str:
        """``ok``, or what the broker, though it is connected, does not take."""
        said = []
        if self._outbox.set_aside:
            said.append(f"{self._outbox.set_aside} readings ({self._outbox.refusal})")
        said += [f"{topic} ({why})" for topic, why in sorted(self._mailbox.refused.copy().items())]
        if not said:
            return "ok"
        text = f"the broker does not take {', '.join(said)}"
        remedies = [self._terms.may_write()] if "authorized" in text else []
        remedies += ["raise its limit of a packet's size"] if "takes packets of" in text else []
        return f"{text}; {' and '.join(remedies) or 'see its log'}"

    def stop(self, drain_s: float, status: bytes) -> None:
        """Send what is owed for so long, say goodbye and hang up; waits until that is done, a little longer at most."""
        self._mailbox.farewell = Farewell(time.monotonic() + drain_s, status)
        self._mailbox.nudge()
        self._thread.join(drain_s + FAREWELL_S + 1.0)
        if self._thread.is_alive():
            log.warning("broker %s did not let go in time; left", self._terms.broker.address)

    def _run(self) -> None:
        try:
            self._keep_connected()
        finally:
            self.connected = False
            self._mailbox.close()

    def _keep_connected(self) -> None:
        while not self._mailbox.over():
            self._connected_at = float("inf")
            try:
                Session(self._terms, self._outbox, self._mailbox, self._accepted).run()
                self.state = f"left {self._terms.broker.address}"
                break
            except LinkLostError as lost:
                self._down(self._reason(lost), by_broker=lost.by_broker)
            except (OSError, ValueError) as error:
                self._down(self._terms.broker.explain(error), by_broker=False)
            except Exception as error:  # outermost loop of the thread: the next connection is a new start
                log.exception("link")
                self._down(f"{self._terms.broker.address}: {type(error).__name__}: {error}", by_broker=False)
            self._pause(min(BACKOFF_MAX_S, 2.0 ** min(self._failures, 10) / 2) * random.uniform(0.5, 1.0))  # noqa: S311

    def _accepted(self) -> None:
        self.connected = True
        self._connected_at = time.monotonic()
        self.state = f"connected to {self._terms.broker.address}"

    def _reason(self, lost: LinkLostError) -> str:
        """What the broker has said counts for the next times too: a reset may overtake its word, and leave a guess."""
        if not lost.by_broker or time.monotonic() - self._connected_at > _STABLE_S:
            self._told = ""
        if lost.told:
            self._told = str(lost)
        return self._told or str(lost)

    def _down(self, text: str, *, by_broker: bool) -> None:
        if time.monotonic() - self._connected_at > _STABLE_S:
            self._failures = 0
            self._complaints.forget()  # things were well; this is news
        self._failures += 1
        self.connected = False
        self.state = text
        self._outbox.link_lost(by_broker=by_broker)
        self._complaints.error(text)

    def _pause(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0 and not self._mailbox.over():
            time.sleep(min(left, 0.1))
        self._mailbox.clear_nudges()
