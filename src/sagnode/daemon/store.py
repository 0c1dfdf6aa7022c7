"""Where the readings of this process are kept: the state directory, or memory while that one is of no use.

A card that turned read-only, lost a sector or was pulled must not end the measuring. Then the journal lies in the
directory in memory that systemd gives, is published from as ever, and is carried over when the card is well again.
What only memory has is lost with a power cut; health and status say so for as long as it lasts.
"""

from __future__ import annotations

import contextlib
import fcntl
import logging
import os
import random
import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from sagnode.daemon.journal import Journal
from sagnode.daemon.own_disk import FSTAB, OwnDisk
from sagnode.daemon.places import JOURNAL, VOLATILE
from sagnode.daemon.sequence import BLOCK, Ceiling
from sagnode.errors import DiskError, JournalError, SagnodeError

log = logging.getLogger(__name__)

VOLATILE_KEEP_MB = 32.0
"""Size limit of a journal in memory."""
DISTRUST_AFTER_S = 60.0
"""A state directory that refused readings for so long is left."""
LOOK_AGAIN_S = 60.0
_PROBE_BYTES = 1_000_000
_NUMBERS_A_MINUTE = 10**8
"""Far more than anybody measures; and 2**53, the greatest number of JSON, is more than a century of them away."""


@dataclass(frozen=True)
class Store:
    """An open journal, held for this process alone."""

    journal: Journal
    directory: Path
    """Of the journal."""
    volatile: bool
    """Whether it is in memory because the state directory is of no use."""


class Stores:
    """Chooses the place, and notices when the other one would be better.

    Args:
        state_dir: the state directory.
        runtime_dir: the directory in memory, None where there is none.
        boot_id: of this boot of the machine.
        service_dir: the service's own directory on the system's disk, where the state directory is another one.
        fstab: what is to be mounted, as in fstab(5).
    """

    def __init__(
        self,
        state_dir: Path,
        runtime_dir: Path | None,
        boot_id: str = "",
        service_dir: Path | None = None,
        fstab: Path = FSTAB,
    ) -> None:
        self._boot_id = boot_id
        self.state_dir = state_dir
        self._own_disk = OwnDisk(state_dir, service_dir, fstab)
        self._counted_elsewhere = service_dir / "sequence" if service_dir else None
        self._volatile_dir = runtime_dir / VOLATILE if runtime_dir else None
        self._distrusted = False
        self._open: Store | None = None
        self._looked_at = float("-inf")
        self._device: int | None = None
        self._counted = 1
        """The state directory's own disk has counted at least so far."""

    @contextlib.contextmanager
    def opened(self) -> Iterator[Store]:
        """The journal, held for this process alone; closed at the end.

        Raises:
            SagnodeError: neither place can be used, or another daemon uses the state directory.
        """
        with contextlib.ExitStack() as stack:
            store = self._choose(stack)
            self._open = store
            self._looked_at = time.monotonic()
            try:
                yield store
            finally:
                self._open = None
                store.journal.close()

    def better(self, refused_s: float) -> bool:
        """Whether readings would be kept better in the other place.

        Args:
            refused_s: for so long the present journal has refused readings.
        """
        if self._open is None or self._volatile_dir is None:
            return False
        if not self._open.volatile:
            self._distrusted = refused_s > DISTRUST_AFTER_S
            return self._distrusted
        if time.monotonic() - self._looked_at < LOOK_AGAIN_S:
            return False
        self._looked_at = time.monotonic()
        self._distrusted = not self._is_well()
        return not self._distrusted

    # -- within

    def _choose(self, stack: contextlib.ExitStack) -> Store:
        if self._distrusted and self._volatile_dir is not None:
            return self._in_memory(stack, self._volatile_dir, f"{self.state_dir} refuses to be written")
        try:
            with contextlib.ExitStack() as attempt:
                self._own_disk.expect()
                attempt.enter_context(alone(self.state_dir))
                self._expect_the_same_disk()
                journal = self._journal_at_home()
                self._own_disk.found()
                self._counted = max(1, Ceiling(self.state_dir / "sequence").value)
                try:
                    self._carry_over(journal)
                except DiskError:
                    journal.close()
                    raise
                stack.push(attempt.pop_all())
                return Store(journal, self.state_dir, volatile=False)
        except DiskError as error:
            if self._volatile_dir is None:
                raise
            return self._in_memory(stack, self._volatile_dir, str(error))

    def _journal_at_home(self) -> Journal:
        return Journal(self.state_dir / JOURNAL, self._boot_id, self._counted_elsewhere)

    def _expect_the_same_disk(self) -> None:
        """An empty mount point must not pass for the disk that was there; one put in again may bear another number."""
        device = self.state_dir.stat().st_dev
        if self._device not in {None, device} and Ceiling(self.state_dir / "sequence").value < self._counted:
            raise DiskError(f"{self.state_dir}: another disk is mounted there now", "mount the node's own again")
        self._device = device

    def _in_memory(self, stack: contextlib.ExitStack, directory: Path, why: str) -> Store:
        stack.enter_context(alone(directory))
        try:
            if not (directory / "sequence").exists():
                known = Ceiling(self.state_dir / "sequence", self._counted_elsewhere).value
                Ceiling(directory / "sequence", self._counted_elsewhere).cover(_leap_over(known, time.time()))
            journal = Journal(directory / JOURNAL, counted_elsewhere=self._counted_elsewhere)
        except OSError as error:
            raise SagnodeError(f"{directory}: {error.strerror}", "free memory, or mend the state directory") from error
        journal.note = f"kept in memory and lost with the power, because {why}"
        log.critical("journal: %s", journal.note)
        return Store(journal, directory, volatile=True)

    def _carry_over(self, journal: Journal) -> None:
        """Bring home what was recorded in memory."""
        if self._volatile_dir is None or not (self._volatile_dir / JOURNAL).exists():
            return
        count = journal.adopt(self._volatile_dir / JOURNAL)
        log.warning("journal: %d readings carried over from memory", count)
        shutil.rmtree(self._volatile_dir, ignore_errors=True)

    def _to_carry_bytes(self) -> int:
        """Room that the readings in memory will need at home."""
        if self._volatile_dir is None:
            return 0
        return sum(file.stat().st_size for file in self._volatile_dir.glob(f"{JOURNAL}*"))

    def _is_well(self) -> bool:
        """Whether the state directory takes a megabyte besides what is to come home, and its journal can be opened."""
        probe = self.state_dir / "probe"
        try:
            self._own_disk.expect()
            with alone(self.state_dir):
                self._expect_the_same_disk()
                # Half a homecoming on a disk that is full again after it would end all recording there.
                if shutil.disk_usage(self.state_dir).free < _PROBE_BYTES + self._to_carry_bytes():
                    return False
                with probe.open("wb") as stream:
                    stream.write(bytes(_PROBE_BYTES))
                    stream.flush()
                    os.fsync(stream.fileno())
                probe.unlink()
                self._journal_at_home().close()
        except (OSError, JournalError, SagnodeError):
            with contextlib.suppress(OSError):
                probe.unlink(missing_ok=True)
            return False
        return True


def _leap_over(known: int, now_s: float) -> int:
    """Where numbers go on whose count cannot be kept: above those of any earlier such time, and never the same ones.

    A machine without a clock of its own begins each boot at a time that was once saved, perhaps the same one again; so
    there is chance in it too.

    Args:
        known: numbers up to this one may have been used.
        now_s: seconds since 1970, by a clock that may be wrong.
    """
    floor = -(-known // BLOCK) * BLOCK
    chance = random.randrange(1, _NUMBERS_A_MINUTE // BLOCK) * BLOCK  # noqa: S311 - not for secrecy
    return max(floor, int(now_s // 60) * _NUMBERS_A_MINUTE) + chance


@contextlib.contextmanager
def alone(directory: Path) -> Iterator[None]:
    """Hold a directory for this process alone.

    Raises:
        DiskError: the disk refuses.
        SagnodeError: not this user's directory, or another daemon holds it.
    """
    remedy = "give the daemon's user a directory to write to: storage.state_dir, or StateDirectory= of its unit"
    try:
        directory.mkdir(parents=True, exist_ok=True)
        lock = (directory / "lock").open("w")
    except PermissionError as error:
        raise SagnodeError(f"state directory {directory}: {error.strerror}", remedy) from error
    except OSError as error:
        raise DiskError(f"state directory {directory}: {error.strerror}", remedy) from error
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            what = f"state directory {directory} is in use by another sagnode"
            raise SagnodeError(what, "stop that one, or give this one its own storage.state_dir") from error
        yield
