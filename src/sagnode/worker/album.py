"""The album: the appearances of landmarks that a worker keeps, in memory and in a file of the state directory.

The worker learns after it has answered, so that no reading waits for it. The file is replaced in one step, at most once
an hour, and only for something new; it is not forced to the card, since what a power cut takes is learnt again. It is
one line of a checksum, one of JSON, and the pictures' bytes. One that is damaged or foreign is told in the log and
begun anew.
"""

from __future__ import annotations

import hashlib
import sys
import time
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from pydantic import AwareDatetime, Field, ValidationError

from sagnode.capture.port import GreyImage
from sagnode.capture.taken import taken_at
from sagnode.estimate.remember import remember
from sagnode.match.appearances import KEPT_MAX, Appearance, Appearances, none_kept
from sagnode.message import LandmarksMessage, Strict
from sagnode.site import Site

FILE = "appearances"
"""In the state directory."""
FILE_MAX_BYTES = 4_000_000
SCHEMA = "sagnode.appearances/1"
LEARN_EVERY = timedelta(minutes=10)
"""Looks change with the sun, not with the wind."""
SAVE_EVERY_S = 3600.0


class _Entry(Strict):
    landmark: str
    side_px: int = Field(ge=3, le=255)
    offset: tuple[float, float]
    cut_at: AwareDatetime
    useful_at: AwareDatetime
    proofs: int = Field(ge=0)


class _Index(Strict):
    schema_version: str
    key: str
    entries: tuple[_Entry, ...]


class Album:
    """What one worker remembers of one site.

    Args:
        site: with its landmarks.
        reference: file of the reference picture, for its age.
        path: of the file; None keeps everything in this process only.
    """

    def __init__(self, site: Site, reference: Path | None = None, path: Path | None = None) -> None:
        self._site = site
        self._path = path
        self._reference = _age_of(reference)
        self._learnt_at: datetime | None = None
        self._saved_s = float("-inf")
        self.kept: Appearances = none_kept(len(site.landmark_ids))
        """Appearances of every landmark of the site."""
        if path is not None:
            self.kept = read_album(path, site)
        self._saved = _gist(self.kept)

    def learn(self, image: GreyImage, at: datetime) -> None:
        """Learn from a frame in which something was measured, where the last lesson is long enough ago."""
        if self._learnt_at is not None and abs(at - self._learnt_at) < LEARN_EVERY:
            return
        self._learnt_at = at
        self.kept = remember(self._site, image, self.kept, at)
        self._save()

    def message(self) -> LandmarksMessage | None:
        """What health tells; None without a reference picture."""
        if self._site.patches is None:
            return None
        cut = sorted(a.cut_at for own in self.kept for a in own if a.proven)
        return LandmarksMessage(
            reference_taken_at=self._reference.reference_taken_at,
            reference_taken_from=self._reference.reference_taken_from,
            appearances=len(cut),
            on_trial=sum(not a.proven for own in self.kept for a in own),
            oldest_at=cut[0] if cut else None,
            newest_at=cut[-1] if cut else None,
        )

    def _save(self) -> None:
        gist = _gist(self.kept)
        if self._path is None or gist == self._saved or time.monotonic() - self._saved_s < SAVE_EVERY_S:
            return
        self._saved_s = time.monotonic()
        try:
            write_album(self._path, self._site, self.kept)
            self._saved = gist
        except OSError as error:
            print(f"{self._path}: {error.strerror}; what landmarks look like is kept in memory only", file=sys.stderr)


def landmarks_key(site: Site) -> str:
    """Digest of all that appearances rest on: the landmarks in the reference picture, their clicks and the lens."""
    digest = hashlib.sha256(repr((site.landmark_ids, site.intrinsics)).encode())
    digest.update(site.landmark_clicks.tobytes())
    for patch in site.patches or ():
        digest.update(b"-" if patch is None else repr(patch.image.shape).encode() + patch.image.tobytes())
    return digest.hexdigest()


def write_album(path: Path, site: Site, kept: Appearances) -> None:
    """Replace the file in one step.

    Raises:
        OSError: it cannot be written.
    """
    named = [(name, a) for name, own in zip(site.landmark_ids, kept, strict=True) for a in own]
    entries = tuple(
        _Entry(
            landmark=name,
            side_px=a.image.shape[0],
            offset=(float(a.offset[0]), float(a.offset[1])),
            cut_at=a.cut_at,
            useful_at=a.useful_at,
            proofs=a.proofs,
        )
        for name, a in named
    )
    index = _Index(schema_version=SCHEMA, key=landmarks_key(site), entries=entries)
    body = index.model_dump_json().encode() + b"\n" + b"".join(a.image.tobytes() for _, a in named)
    if len(body) > FILE_MAX_BYTES:
        raise OSError(27, "the pictures of so many and so large landmarks exceed its limit")
    beside = path.with_name(path.name + ".part")
    beside.write_bytes(hashlib.sha256(body).hexdigest().encode() + b"\n" + body)
    beside.replace(path)


def read_album(path: Path, site: Site) -> Appearances:
    """The appearances of a site out of its file; none, with a line on standard error, where the file is of no use."""
    try:
        if path.stat().st_size > FILE_MAX_BYTES + 100:
            raise ValueError("larger than it can be")
        checksum, _, body = path.read_bytes().partition(b"\n")
        if hashlib.sha256(body).hexdigest().encode() != checksum:
            raise ValueError("damaged")
        line, _, pixels = body.partition(b"\n")
        index = _Index.model_validate_json(line)
        if index.schema_version != SCHEMA:
            raise ValueError(f"of another version ({index.schema_version})")
        if index.key != landmarks_key(site):
            raise ValueError("of another reference picture, other clicks or another lens")
        return _arranged(site, index, pixels)
    except FileNotFoundError:
        return none_kept(len(site.landmark_ids))
    except (OSError, ValueError, ValidationError) as error:
        text = error.strerror if isinstance(error, OSError) else str(error).partition("\n")[0]
        print(f"{path}: {text}; what landmarks look like is learnt anew", file=sys.stderr)
        return none_kept(len(site.landmark_ids))


def _arranged(site: Site, index: _Index, pixels: bytes) -> Appearances:
    """Raises ValueError where the index and the pixels do not belong together."""
    by_name: dict[str, list[Appearance]] = {name: [] for name in site.landmark_ids}
    begin = 0
    for entry in index.entries:
        size = entry.side_px**2
        if entry.landmark not in by_name or len(by_name[entry.landmark]) >= KEPT_MAX or begin + size > len(pixels):
            raise ValueError("its parts do not belong together")
        image = np.frombuffer(pixels, np.uint8, size, begin).reshape(entry.side_px, entry.side_px)
        begin += size
        by_name[entry.landmark].append(
            Appearance(image, np.array(entry.offset), entry.cut_at, entry.useful_at, entry.proofs)
        )
    return tuple(tuple(own) for own in by_name.values())


def _gist(kept: Appearances) -> tuple[tuple[tuple[datetime, bool], ...], ...]:
    """What is worth a write: which appearances there are, and which of them may be used."""
    return tuple(tuple((a.cut_at, a.proven) for a in own) for own in kept)


def _age_of(reference: Path | None) -> LandmarksMessage:
    """When the reference picture was taken, as far as its file tells."""
    try:
        taken = taken_at(reference) if reference is not None else None
    except OSError:
        taken = None
    at, origin = taken if taken is not None else (None, None)
    return LandmarksMessage(reference_taken_at=at, reference_taken_from=origin, appearances=0, on_trial=0)
