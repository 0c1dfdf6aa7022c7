"""The worker's own life: read the configuration, open the camera, then one line in, one burst measured, one line out.

It never decides to give up on a reading's deadline or on memory: the daemon kills it. But a burst whose frames take
long, as they do under ice, is measured only as far as its deadline allows. Whatever the worker cannot do it says with
a :class:`sagnode.worker.protocol.Fault`; a fatal one is its last line.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import IO, TYPE_CHECKING

from pydantic import ValidationError

from sagnode.errors import EndOfFrames, FrameError, SagnodeError
from sagnode.message import LensMessage, ReasonMessage
from sagnode.quality import Cause, Reason, Validity
from sagnode.worker import confine
from sagnode.worker.protocol import ConductorResult, Fault, Hello, MeasureReply, MeasureRequest, WorkerLine

if TYPE_CHECKING:
    from sagnode.capture.port import Frame, FrameSource, GreyImage
    from sagnode.config.load import LoadedNode
    from sagnode.measurement import ConductorMeasurement
    from sagnode.site import Site
    from sagnode.worker.album import Album

EXIT_FATAL = 70
"""After a fatal fault (sysexits.h: internal software error)."""
MEASURING_SHARE = 0.7
"""Share of a reading's deadline by which the last frame of a burst should be measured; the rest is for drawing."""


def main(argv: list[str]) -> int:
    """Entry of the child process; returns its exit status."""
    parser = argparse.ArgumentParser(prog="python -m sagnode.worker")
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--requests-fd", type=int, required=True)
    parser.add_argument("--replies-fd", type=int, required=True)
    parser.add_argument("--parent", type=int, required=True)
    parser.add_argument("--resume-after", type=datetime.fromisoformat, default=None)
    parser.add_argument("--album", type=Path, default=None)
    args = parser.parse_args(argv)
    if not confine.die_with_parent(args.parent):
        return 0
    confine.volunteer_for_oom()
    with os.fdopen(args.requests_fd, "rb") as requests, os.fdopen(args.replies_fd, "wb") as replies:
        try:
            return _Worker(args.config, args.resume_after, args.album, replies).serve(requests)
        except BrokenPipeError:
            return 0  # the daemon has gone
        except KeyboardInterrupt:
            return 130
        except Exception as error:  # noqa: BLE001 - outermost loop of the process: its last words
            traceback.print_exc()
            kind = Cause.WORKER_CRASHED
            text = f"worker: {type(error).__name__}: {error}; it is started anew, its log has the traceback"
            with contextlib.suppress(OSError):
                _send(replies, Fault(reason=ReasonMessage.of(Reason(kind, text)), fatal=True))
            return EXIT_FATAL


@dataclass(frozen=True)
class _Task:
    """What a worker measures with."""

    loaded: LoadedNode
    site: Site
    source: FrameSource
    album: Album | None
    """None where no appearances are kept."""


class _Worker:
    """One configuration, one camera, one site."""

    def __init__(self, config: Path, resume_after: datetime | None, album: Path | None, replies: IO[bytes]) -> None:
        self._config = config
        self._resume_after = resume_after
        self._album = album
        self._replies = replies

    def serve(self, requests: IO[bytes]) -> int:
        """Answer requests until the daemon closes the pipe."""
        # Imported here so that a broken installation of OpenCV or of a camera library is told by a line.
        from sagnode.capture import open_source
        from sagnode.config.load import LoadedNode, load_node
        from sagnode.pipeline import load_site
        from sagnode.worker.album import Album

        try:
            snapshot = sys.stdin.buffer.read()
            # The daemon's snapshot counts: the files may have been edited since, and readings carry the daemon's id.
            loaded = LoadedNode.from_snapshot(snapshot) if snapshot else load_node(self._config)
            site = load_site(loaded.span, loaded.node.measure)
            album = None
            if loaded.node.measure.appearances:
                album = Album(site, loaded.span.camera.reference_image, self._album)
            source = open_source(loaded.node.camera)
        except SagnodeError as error:
            return self._fatal(Cause.BAD_CALIBRATION, str(error))
        try:
            source.open()
            if self._resume_after is not None:
                source.skip_until(self._resume_after)
        except FrameError as error:
            source.close()
            return self._fatal(error.cause, str(error))
        confine.limit_growth(loaded.node.worker.memory_max_mb)
        try:
            self._say(
                Hello(
                    pid=os.getpid(),
                    camera=source.describe(),
                    calibration_id=site.calibration_id,
                    first_frame_at=source.first_frame_at(),
                )
            )
            return self._answer(requests, _Task(loaded, site, source, album))
        finally:
            source.close()

    def _answer(self, requests: IO[bytes], task: _Task) -> int:
        source = task.source
        live = source.first_frame_at() is None
        camera_lost = False
        for line in requests:
            try:
                request = MeasureRequest.model_validate_json(line)
            except ValidationError as error:
                return self._fatal(Cause.WORKER_GARBAGE, f"request not understood: {error.error_count()} faults")
            try:
                if camera_lost:
                    source.open()
                    camera_lost = False
                reply, first = _measure(request, task)
                self._say(reply)
                # after the answer: no reading waits for what the next ones may be better for
                if task.album is not None and any(r.validity is not Validity.INVALID for r in reply.results):
                    task.album.learn(first.image, first.utc)
            except EndOfFrames as error:
                self._say(Fault(id=request.id, reason=ReasonMessage.of(error.reason), end_of_frames=True))
            except FrameError as error:
                # A live camera is closed and opened anew for the next reading; files would begin from their start.
                if live and error.cause is Cause.CAMERA_FAULT:
                    source.close()
                    camera_lost = True
                self._say(Fault(id=request.id, reason=ReasonMessage.of(error.reason)))
            except MemoryError:
                limit = task.loaded.node.worker.memory_max_mb
                text = f"worker: more than {limit} MB beyond its start; raise worker.memory_max_mb if this repeats"
                return self._fatal(Cause.WORKER_CRASHED, text, request.id)
        return 0

    def _fatal(self, cause: Cause, text: str, request_id: int | None = None) -> int:
        self._say(Fault(id=request_id, reason=ReasonMessage.of(Reason(cause, text)), fatal=True))
        return EXIT_FATAL

    def _say(self, line: WorkerLine) -> None:
        _send(self._replies, line)


def _send(replies: IO[bytes], line: WorkerLine) -> None:
    replies.write(line.model_dump_json().encode() + b"\n")
    replies.flush()


class Burst:
    """Hands a burst's pictures on one by one, and holds no more of them than the first, whose time is the reading's.

    Where measuring one more, as long as the slowest took, would last beyond ``deadline_s`` from the start, it is not
    handed on: a reading of fewer frames is worth more than none. The frames that are left are let go.
    """

    def __init__(self, frames: Iterator[Frame], deadline_s: float) -> None:
        self._frames = frames
        self._deadline_s = deadline_s
        self._waited_s = 0.0
        self._started = time.monotonic()
        self.first = self._next()

    def __iter__(self) -> Iterator[GreyImage]:
        """Every picture once, as far as there is time."""
        began = time.monotonic()
        yield self.first.image
        slowest, measured = time.monotonic() - began, 1
        while True:
            frame = self._next_or_none()
            if frame is None:
                return
            began = time.monotonic()
            if began + slowest > self._started + self._deadline_s:
                break
            yield frame.image
            # not held while the next one is read
            del frame
            slowest, measured = max(slowest, time.monotonic() - began), measured + 1
        text = f"burst cut short after {measured} frames: one takes {slowest:.1f} s; see schedule.deadline_s"
        print(text, file=sys.stderr)
        while frame is not None:
            frame = self._next_or_none()

    def elapsed_s(self) -> float:
        """Time since the first frame was asked for, without that of waiting for frames."""
        return time.monotonic() - self._started - self._waited_s

    def _next_or_none(self) -> Frame | None:
        try:
            return self._next()
        except StopIteration:
            return None

    def _next(self) -> Frame:
        """Raises FrameError, and StopIteration after the last."""
        began = time.monotonic()
        try:
            return next(self._frames)
        finally:
            self._waited_s += time.monotonic() - began


def _measure(request: MeasureRequest, task: _Task) -> tuple[MeasureReply, Frame]:
    """One burst, measured, and its first frame."""
    from sagnode.estimate.explain import lens_of
    from sagnode.pipeline import measure_burst

    camera, site, source, album = task.loaded.node.camera, task.site, task.source, task.album
    deadline_s = MEASURING_SHARE * task.loaded.node.schedule.deadline_s
    burst = Burst(source.frames(camera.burst, camera.burst_interval_s), deadline_s)
    measurements = measure_burst(site, burst, album.kept if album else ())
    lens = lens_of(site, burst.first.image)
    elapsed = burst.elapsed_s()
    overlays = _draw(Path(request.overlay_dir), burst.first, measurements) if request.overlay_dir else {}
    reply = MeasureReply(
        id=request.id,
        acquired_at=burst.first.utc,
        monotonic_s=burst.first.monotonic_s,
        camera=source.describe(),
        results=tuple(conductor_result(measurement) for measurement in measurements),
        overlays=overlays,
        lens=LensMessage(look=lens.look, share=lens.share, text=lens.text),
        landmarks=album.message() if album else None,
        elapsed_s=elapsed,
        memory_mb=confine.resident_mb(),
        next_frame_at=source.first_frame_at(),
    )
    return reply, burst.first


def conductor_result(measurement: ConductorMeasurement) -> ConductorResult:
    """A measurement as it goes through the pipe."""
    fields = {name: getattr(measurement, name) for name in ConductorResult.model_fields}
    fields["reasons"] = tuple(ReasonMessage.of(reason) for reason in measurement.reasons)
    return ConductorResult.model_validate(fields)


def _draw(directory: Path, frame: Frame, measurements: list[ConductorMeasurement]) -> dict[str, str]:
    """Write ``<conductor>.jpg`` for each conductor; a disk that refuses costs the picture, not the reading."""
    import cv2

    from sagnode.overlay import draw_overlay

    written = {}
    for measurement in measurements:
        picture = draw_overlay(frame.image, [measurement])
        encoded, jpeg = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 85])
        path = directory / f"{measurement.conductor}.jpg"
        half_written = path.with_suffix(".jpg.part")
        try:
            if encoded:
                half_written.write_bytes(jpeg.tobytes())
                half_written.replace(path)
                written[measurement.conductor] = str(path)
        except OSError as error:
            print(f"picture {path}: {error}", file=sys.stderr)
            with contextlib.suppress(OSError):  # on a full disk the half of it takes the readings' room
                half_written.unlink(missing_ok=True)
    return written
