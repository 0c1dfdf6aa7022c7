"""``sagnode replay``: stored frames measured again, by the code and with the settings of the node."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from sagnode.errors import ConfigError, EndOfFrames, FrameError, SagnodeError
from sagnode.outfile import whole_text

if TYPE_CHECKING:
    from datetime import datetime

    from sagnode.capture.port import Frame, FrameSource
    from sagnode.config.load import LoadedNode, LoadedSpan
    from sagnode.daemon.stamp import Stamp
    from sagnode.measurement import ConductorMeasurement
    from sagnode.message import ReadingHeader
    from sagnode.site import Site
    from sagnode.trend.watch import Trend

DESCRIPTION = """Measure the frames of a directory, glob or video in their order, as the node would have: the same
bursts, judgement, watch over the readings' trend, and appearances of landmarks learnt on the way. Times come from the
files' names, their EXIF or the files themselves. Where a truth lies beside the frames (sagnode scene), the readings are
compared with it; with --against, with those of a journal or of an earlier replay or export."""
EPILOG = """exit codes: 0 fine, 1 a frame could not be read, or a reading differs from --against (in validity, or by
more than its own standard uncertainty), 2 usage or bad configuration"""
NOBODY = "replay"
"""Utility, line and unit of readings where only a span file was given."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Frames, configuration, output, what to compare with."""
    parser.add_argument("frames", metavar="FRAMES", help="a directory, a glob in quotes, or a video")
    parser.add_argument(
        "--config", type=Path, required=True, metavar="PATH", help="node file, span file, or the directory of either"
    )
    parser.add_argument("--out", metavar="FILE", help="write the readings as JSON lines; - is standard output")
    parser.add_argument("--burst", type=int, metavar="N", help="frames a reading (default: the node's)")
    parser.add_argument("--cadence", type=float, metavar="S", help="seconds between frames that tell no time")
    parser.add_argument(
        "--against", type=Path, metavar="PATH", help="journal, state directory or JSON lines to compare with"
    )


def run(args: argparse.Namespace) -> int:
    """Measure, write, compare."""
    from sagnode.cli.replay_compare import compare, earlier_readings
    from sagnode.config.load import load_any
    from sagnode.demo.results import join, read_truth, readings_summary

    source = _source(args)
    earlier = earlier_readings(args.against) if args.against else None
    loaded = load_any(args.config)
    readings: list[ReadingHeader] = []
    unread = 0
    with _opened(args.out) as sink:
        # the readings have standard output where they were sent there, and the rest makes way
        said = sys.stderr if sink is sys.stdout else sys.stdout
        for some, error in _measured(loaded, source, args.burst):
            readings += some
            if error is not None:
                unread += 1
                print(f"sagnode: warning: {error}", file=sys.stderr)
            for reading in some:
                print(reading.model_dump_json() if sink else _line(reading), file=sink or said, flush=True)
            if sink and sys.stderr.isatty():
                print(f"\rmeasured {len(readings)} readings ", end="", file=sys.stderr, flush=True)
        if sink and sys.stderr.isatty():
            print(file=sys.stderr)
    folder = Path(args.frames)
    points = join(readings, read_truth(folder if folder.is_dir() else folder.parent))
    print("\n".join(readings_summary(points)), file=said)
    if args.out and args.out != "-":
        print(f"wrote {len(readings)} readings to {args.out}", file=said)
    differs = False
    if earlier is not None:
        comparison = compare(readings, earlier)
        print("\n".join(comparison.lines), file=said)
        differs = comparison.differs
    return 1 if unread or differs else 0


@contextmanager
def _opened(name: str | None) -> Iterator[TextIO | None]:
    if name is None or name == "-":
        yield sys.stdout if name else None
        return
    try:
        with whole_text(Path(name), keep_interrupted=True) as stream:
            yield stream
    except OSError as error:
        raise SagnodeError(f"cannot write {name}: {error.strerror}", "choose another --out") from None


def _line(reading: ReadingHeader) -> str:
    """One reading for a screen."""
    from sagnode.cli.readings import clearance_text, sag_text
    from sagnode.message import QUANTITIES, reading_estimate

    told = {stem: e for stem, *_ in QUANTITIES if (e := reading_estimate(reading, stem)) is not None}
    causes = ", ".join(reason.cause for reason in reading.quality.reasons)
    quality = f"{reading.quality.validity} ({causes})" if causes else str(reading.quality.validity)
    text = f"{reading.acquired_at:%Y-%m-%d %H:%M:%S}  {reading.conductor:<8}  sag {sag_text(told.get('sag')):<18}"
    return f"{text}  clearance {clearance_text(told):<34}  {quality}"


def _source(args: argparse.Namespace) -> FrameSource:
    from sagnode.capture.replay import Replay
    from sagnode.config.node import ReplaySource

    if args.burst is not None and not 1 <= args.burst <= 64:
        raise ConfigError(f"--burst {args.burst}: out of range", "1 to 64 frames a reading")
    if args.cadence is not None and not 0 < args.cadence < 1e7:
        raise ConfigError(f"--cadence {args.cadence:g}: out of range", "a positive number of seconds")
    return Replay(ReplaySource(path=args.frames, cadence_s=args.cadence))


def _measured(
    loaded: LoadedNode | LoadedSpan, source: FrameSource, burst: int | None
) -> Iterator[tuple[list[ReadingHeader], FrameError | None]]:
    """Readings burst by burst, numbered from 1, and why a burst could not be read."""
    from sagnode.config.load import LoadedNode
    from sagnode.pipeline import load_site, measure_burst
    from sagnode.quality import Validity
    from sagnode.worker.album import Album

    node = loaded.node if isinstance(loaded, LoadedNode) else None
    count = burst or (node.camera.burst if node else 1)
    site = load_site(loaded.span, node.measure if node else None)
    stamp, trend = _stamp(loaded, site), _trend(loaded)
    album = Album(site) if node is None or node.measure.appearances else None
    source.open()
    number = 0
    first: datetime | None = None
    try:
        while (at := source.first_frame_at()) is not None:
            first = first or at
            error = None
            try:
                frames = source.burst(count, 0.0)
                measured = measure_burst(site, [f.image for f in frames], album.kept if album else ())
                if album is not None and any(m.validity is not Validity.INVALID for m in measured):
                    album.learn(frames[0].image, frames[0].utc)
                readings = _stamped(stamp, site, frames, measured, first)
            except EndOfFrames:
                return
            except FrameError as fault:
                error = fault
                readings = stamp.refusal(
                    fault.reason,
                    at=at,
                    monotonic_s=(at - first).total_seconds(),
                    clock_synced=True,
                    calibration_id=site.calibration_id,
                )
            if trend is not None:
                readings = trend.judge(readings)
            yield [r.model_copy(update={"sequence": number + k}) for k, r in enumerate(readings, start=1)], error
            number += len(readings)
    finally:
        source.close()


def _stamp(loaded: LoadedNode | LoadedSpan, site: Site) -> Stamp:
    """What all readings have in common, as the daemon sets it."""
    from sagnode import __version__
    from sagnode.config.load import LoadedNode
    from sagnode.daemon.stamp import Stamp
    from sagnode.message import Identity

    identity = Identity(utility=NOBODY, line=NOBODY, span=loaded.span.name, unit=NOBODY)
    test = False
    if isinstance(loaded, LoadedNode):
        unit = loaded.node.unit
        identity = Identity(utility=unit.utility, line=unit.line, span=unit.span, unit=unit.unit)
        test = unit.commissioning
    return Stamp(
        identity=identity,
        conductors={c.id: c.phase for c in loaded.span.conductors if c.measured},
        method=site.method,
        configuration_id=loaded.configuration_id,
        software_version=__version__,
        boot_id=NOBODY,
        test=test,
    )


def _trend(loaded: LoadedNode | LoadedSpan) -> Trend | None:
    """The daemon's watch over the readings, beginning without a past; None where the node is told not to watch."""
    from sagnode.config.load import LoadedNode
    from sagnode.config.node import Trend as Settings
    from sagnode.trend.watch import Trend, Watched

    settings = loaded.node.trend if isinstance(loaded, LoadedNode) else Settings()
    if not settings.watch:
        return None
    watched = {c.id: Watched.of(c) for c in loaded.span.conductors if c.measured}
    return Trend(watched, settings.accept_after_s)


def _stamped(
    stamp: Stamp, site: Site, frames: list[Frame], measurements: list[ConductorMeasurement], first: datetime
) -> list[ReadingHeader]:
    """Readings as the daemon makes them of a worker's reply."""
    from sagnode.worker.child import conductor_result
    from sagnode.worker.protocol import MeasureReply

    reply = MeasureReply(
        id=1,
        acquired_at=frames[0].utc,
        monotonic_s=(frames[0].utc - first).total_seconds(),
        camera=frames[0].source,
        results=tuple(conductor_result(measurement) for measurement in measurements),
        elapsed_s=0.0,
        memory_mb=0.0,
    )
    return stamp.reply(reply, clock_synced=True, calibration_id=site.calibration_id)
