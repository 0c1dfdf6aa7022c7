"""A burst in the worker: as many of its frames as the deadline leaves time for."""

import time
from collections.abc import Iterator
from datetime import UTC, datetime

import numpy as np
import pytest

from sagnode.capture.port import Frame
from sagnode.worker.child import Burst

FRAME_S = 0.15


def frames(count: int, given: list[int]) -> Iterator[Frame]:
    for number in range(count):
        given.append(number)
        image = np.full((2, 2), number, dtype=np.uint8)
        yield Frame(image, datetime(2026, 1, 1, tzinfo=UTC), 0.0, f"{number}.png")


def measured(burst: Burst) -> list[int]:
    seen = []
    for image in burst:
        seen.append(int(image[0, 0]))
        time.sleep(FRAME_S)
    return seen


def test_a_burst_is_handed_on_whole_where_there_is_time() -> None:
    assert measured(Burst(frames(3, []), deadline_s=600.0)) == [0, 1, 2]


def test_a_burst_that_takes_too_long_is_cut_short_and_its_other_frames_let_go(
    capfd: pytest.CaptureFixture[str],
) -> None:
    given: list[int] = []
    seen = measured(Burst(frames(8, given), deadline_s=3.5 * FRAME_S))
    # a busy machine may find time for fewer, none for more
    assert seen == list(range(len(seen)))
    assert 1 <= len(seen) <= 3
    assert given == list(range(8)), "files go on with the next burst, not with what is left of this one"
    assert f"cut short after {len(seen)} frames" in capfd.readouterr().err
