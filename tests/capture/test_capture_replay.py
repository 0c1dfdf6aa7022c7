"""Replay: order, times, bursts, damaged files, and what comes after the last frame."""

from __future__ import annotations

import os
import struct
import weakref
from datetime import UTC, datetime, timedelta
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from sagnode.capture import open_source
from sagnode.capture.port import Frame, FrameSource
from sagnode.capture.replay import Replay
from sagnode.capture.taken import name_time, taken_at
from sagnode.config.node import Camera, ReplaySource
from sagnode.errors import EndOfFrames, FrameError
from sagnode.quality import Cause

NOON = datetime(2026, 6, 21, 12, 0, tzinfo=UTC)


def picture(value: int) -> np.ndarray:
    return np.full((32, 48), value, np.uint8)


def write_day(folder: Path, count: int = 5, minutes: int = 15) -> list[Path]:
    files = []
    for i in range(count):
        files.append(folder / f"{NOON + timedelta(minutes=minutes * i):%Y%m%dT%H%M%SZ}.png")
        cv2.imwrite(str(files[-1]), picture(10 * i + 5))
    return files


def opened(path: Path | str, **config: object) -> Replay:
    source = Replay(ReplaySource.model_validate({"path": str(path), **config}))
    source.open()
    return source


def values(source: Replay, count: int = 1) -> list[int]:
    return [int(frame.image[0, 0]) for frame in source.burst(count, 0.0)]


@pytest.mark.parametrize(
    ("stem", "expected"),
    [
        ("20260621T113000Z", "2026-06-21T11:30:00+00:00"),
        ("cam1_2026-06-21_11-30-00", "2026-06-21T11:30:00+00:00"),
        ("2026-06-21T11:30:00.25Z_7", "2026-06-21T11:30:00.250000+00:00"),
        ("20260621T133000+0200", "2026-06-21T11:30:00+00:00"),
        ("20260621113000", "2026-06-21T11:30:00+00:00"),
        ("20261321T113000Z", None),
        ("frame0012", None),
        ("123456789012345678", None),
    ],
)
def test_times_in_names(stem: str, expected: str | None) -> None:
    found = name_time(stem)
    assert (found.isoformat() if found else None) == expected


def test_exif_comes_before_the_modification_time(tmp_path: Path) -> None:
    taken = b"2026:06:21 13:30:00\0"
    offset = b"+02:00\0"
    # One directory with the pointer to the Exif directory, which holds DateTimeOriginal and OffsetTimeOriginal.
    first = struct.pack("<HHHIII", 1, 0x8769, 4, 1, 26, 0)
    texts = 26 + 2 + 2 * 12 + 4
    exif = struct.pack("<HHHII", 2, 0x9003, 2, len(taken), texts) + struct.pack(
        "<HHIII", 0x9011, 2, len(offset), texts + len(taken), 0
    )
    tiff = b"II*\0" + struct.pack("<I", 8) + first + exif + taken + offset
    body = b"Exif\0\0" + tiff
    jpeg = cv2.imencode(".jpg", picture(99))[1].tobytes()
    file = tmp_path / "IMG_0001.JPG"
    file.write_bytes(jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:])
    assert taken_at(file) == (datetime(2026, 6, 21, 11, 30, tzinfo=UTC), "exif")
    file.write_bytes(jpeg)
    os.utime(file, (1_750_000_000, 1_750_000_000))
    assert taken_at(file) == (datetime.fromtimestamp(1_750_000_000, UTC), "modified")


def test_a_directory_is_shown_in_natural_order_with_its_own_times(tmp_path: Path) -> None:
    write_day(tmp_path)
    (tmp_path / "truth.json").write_text("{}")
    source = opened(tmp_path)
    assert source.first_frame_at() == NOON
    frames = source.burst(2, 0.0)
    assert [f.utc for f in frames] == [NOON, NOON + timedelta(minutes=15)]
    assert frames[0].metadata["time_from"] == "name"
    assert source.first_frame_at() == NOON + timedelta(minutes=30)
    assert values(source, 2) == [25, 35]
    assert values(source, 2) == [45]  # the last burst is what is left
    with pytest.raises(EndOfFrames, match="last frame"):
        source.burst(1, 0.0)
    assert source.first_frame_at() is None


def test_files_are_read_one_by_one_as_their_frames_are_asked_for(tmp_path: Path) -> None:
    files = write_day(tmp_path)
    source = opened(tmp_path)
    frames = source.frames(3, 0.0)
    shown = [int(next(frames).image[0, 0])]
    cv2.imwrite(str(files[1]), picture(200))  # the second file was not read with the first
    shown += [int(frame.image[0, 0]) for frame in frames]
    assert shown == [5, 200, 25]
    # a burst that nobody looked at to its end has been shown all the same
    next(source.frames(2, 0.0))
    assert source.first_frame_at() is None


class ThreeAtOnce(FrameSource):
    """Stands for a live camera, of which there is none here."""

    def open(self) -> None:
        pass

    def burst(self, count: int, interval_s: float) -> list[Frame]:
        return [Frame(picture(i), NOON, 0.0, "camera") for i in range(count)]

    def close(self) -> None:
        pass


def test_a_camera_that_takes_all_frames_first_holds_none_that_it_has_handed_on() -> None:
    frames = ThreeAtOnce().frames(3, 0.0)
    seen = []
    frame: Frame | None
    for value in range(3):
        frame = next(frames)
        assert int(frame.image[0, 0]) == value
        seen.append(weakref.ref(frame.image))
        frame = None
        assert seen[-1]() is None
    assert next(frames, None) is None


def test_numbers_in_names_are_numbers(tmp_path: Path) -> None:
    for i in (1, 2, 10):
        cv2.imwrite(str(tmp_path / f"frame{i}.png"), picture(i))
    source = opened(tmp_path / "frame*.png", cadence_s=60, start="2026-06-21T14:00:00+02:00")
    frames = source.burst(3, 0.0)
    assert [int(f.image[0, 0]) for f in frames] == [1, 2, 10]
    assert [f.utc for f in frames] == [NOON + timedelta(minutes=i) for i in range(3)]


def test_a_damaged_file_costs_its_burst_and_no_more(tmp_path: Path) -> None:
    files = write_day(tmp_path, 6)
    files[2].write_bytes(files[2].read_bytes()[:40])
    source = opened(tmp_path)
    assert values(source, 2) == [5, 15]
    with pytest.raises(FrameError, match="cut off") as caught:
        source.burst(2, 0.0)
    assert caught.value.cause is Cause.BAD_FRAME and not isinstance(caught.value, EndOfFrames)
    assert values(source, 2) == [45, 55]


def test_hold_reports_stale_frames_and_shows_what_is_added(tmp_path: Path) -> None:
    write_day(tmp_path, 2)
    source = opened(tmp_path, at_end="hold")
    assert values(source, 2) == [5, 15]
    with pytest.raises(FrameError, match="no frame after") as caught:
        source.burst(1, 0.0)
    assert caught.value.cause is Cause.STALE_FRAME
    cv2.imwrite(str(tmp_path / "20260622T000000Z.png"), picture(77))
    assert values(source) == [77]


def test_a_loop_never_runs_back_in_time(tmp_path: Path) -> None:
    write_day(tmp_path, 3)
    source = opened(tmp_path, at_end="loop")
    times = [source.burst(1, 0.0)[0].utc for _ in range(8)]
    assert {b - a for a, b in pairwise(times)} == {timedelta(minutes=15)}


@pytest.mark.parametrize("at_end", ["stop", "loop"])
def test_a_new_worker_goes_on_where_the_last_one_ended(tmp_path: Path, at_end: str) -> None:
    write_day(tmp_path, 5)
    first = opened(tmp_path, at_end=at_end)
    shown = 3 if at_end == "stop" else 13
    last = [first.burst(1, 0.0)[0] for _ in range(shown)][-1]
    second = opened(tmp_path, at_end=at_end)
    second.skip_until(last.utc)
    assert second.first_frame_at() == first.first_frame_at()
    assert values(second) == values(first)


def test_a_video_keeps_its_rate_and_its_start(tmp_path: Path) -> None:
    path = tmp_path / "20260621T120000Z.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 4.0, (64, 48))
    for i in range(8):
        writer.write(np.full((48, 64, 3), 20 + 20 * i, np.uint8))
    writer.release()
    source = opened(path)
    frames = source.burst(8, 0.0)
    assert [f.utc for f in frames] == [NOON + timedelta(seconds=0.25 * i) for i in range(8)]
    assert all(abs(int(f.image[20, 20]) - (20 + 20 * i)) < 4 for i, f in enumerate(frames))
    with pytest.raises(EndOfFrames):
        source.burst(1, 0.0)
    again = opened(path)
    again.skip_until(frames[4].utc)
    assert abs(values(again)[0] - 120) < 4
    again.close()
    again.close()


def test_what_cannot_be_replayed_says_why(tmp_path: Path) -> None:
    for path, says in [
        (tmp_path / "none", "no such file"),
        (tmp_path / ("x" * 300), "File name too long"),
        (tmp_path, "no pictures"),
        (tmp_path / "*.png", "no pictures"),
    ]:
        with pytest.raises(FrameError, match=says):
            opened(path)
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(FrameError, match="neither a picture nor a video"):
        opened(tmp_path / "a.txt")
    (tmp_path / "a.mp4").write_bytes(b"not a video")
    with pytest.raises(FrameError, match="cannot be opened"):
        opened(tmp_path / "a.mp4")


def test_times_that_run_back_are_refused_before_they_mislead(tmp_path: Path) -> None:
    for i in range(2):
        cv2.imwrite(str(tmp_path / f"{i}.png"), picture(i))
        os.utime(tmp_path / f"{i}.png", (1_750_000_000, 1_750_000_000))
    with pytest.raises(FrameError, match="not later"):
        opened(tmp_path)
    assert len(opened(tmp_path, cadence_s=1.0).burst(2, 0.0)) == 2


def test_the_configured_back_end_is_chosen(tmp_path: Path) -> None:
    write_day(tmp_path, 1)
    camera = Camera.model_validate({"backend": "replay", "replay": {"path": str(tmp_path)}})
    source = open_source(camera)
    with pytest.raises(FrameError, match="closed"):
        source.burst(1, 0.0)
    source.open()
    assert len(source.burst(camera.burst, 0.0)) == 1
    assert "frame 1 of 1" in source.describe()
