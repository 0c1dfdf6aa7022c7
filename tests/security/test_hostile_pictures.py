"""Picture and video files made to do harm: refused with a line, within bounded memory, and they fetch nothing."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from sagnode.capture.tracks import find_track
from sagnode.errors import FrameError

HARMLESS = ("png whose data unpack", "png with a comment", "tiff that gives its size twice")
"""These are pictures all the same: what is too much in them is not unpacked."""


def test_damaged_and_hostile_pictures_are_read_or_refused_and_nothing_else():
    """A process of its own: a crash of a decoder must not take the tests along. More: the script's own words."""
    script = Path(__file__).with_name("picture_fuzz.py")
    result = subprocess.run([sys.executable, str(script), "800", "7"], capture_output=True, text=True, timeout=100)
    assert result.returncode == 0, result.stdout[-3000:] + result.stderr[-3000:]
    lines = result.stdout.splitlines()
    assert lines[-1].startswith("800 damaged pictures, 0 uncaught errors")
    asked_for_much = [line for line in lines if " bytes  " in line]
    assert len(asked_for_much) == 14
    for line in asked_for_much:
        assert not line.endswith(": read") or any(name in line for name in HARMLESS), line


@pytest.mark.parametrize(
    "content", ["#EXTM3U\n#EXTINF:1,\nURL/a.ts\n#EXT-X-ENDLIST\n", "ffconcat version 1.0\nfile URL/a.mp4\n"]
)
@pytest.mark.parametrize("suffix", [".mp4", ".ts", ".mkv"])
def test_a_playlist_in_a_videos_clothes_fetches_nothing(tmp_path, content, suffix):
    """FFmpeg looks at the content and not at the name."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        video = tmp_path / f"x{suffix}"
        video.write_text(content.replace("URL", f"http://127.0.0.1:{server.getsockname()[1]}"))
        with pytest.raises(FrameError, match=r"the video (cannot be opened|states no frame rate)"):
            find_track(str(video)).read(0)
        server.setblocking(False)
        with pytest.raises(BlockingIOError):  # nobody waits there
            server.accept()


def test_a_video_may_not_claim_any_size(tmp_path, monkeypatch):
    import cv2
    import numpy as np

    from sagnode.capture import tracks

    path = tmp_path / "x.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 5, (160, 120), False)
    writer.write(np.full((120, 160), 90, np.uint8))
    writer.release()
    assert find_track(str(path)).read(0)[0].shape == (120, 160)
    monkeypatch.setattr(tracks, "MAX_PIXELS", 160 * 120 - 1)  # in place of a video of 64 megapixels
    with pytest.raises(FrameError, match="claims frames of 160x120 px"):
        find_track(str(path))
