"""What a disk has no room for leaves no stump under the name that was asked for, and what was there stays."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sagnode.capture.images import read_grey, write_png
from sagnode.outfile import whole, whole_text

# The kernel refuses a file's bytes beyond this as it does on a full disk.
LITTLE_ROOM = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))\n"
NOISE = np.random.default_rng(1).integers(0, 256, (100, 100), np.uint8)

WRITERS = {
    "text": "from sagnode.outfile import whole_text\nwith whole_text(path) as out: out.write('1.5,' * 5000)",
    "png": "import numpy as np\nfrom sagnode.capture.images import write_png\n"
    "write_png(path, np.random.default_rng(1).integers(0, 256, (100, 100), np.uint8))",
}


def full(code: str, path: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-c", f"from pathlib import Path\npath = Path({str(path)!r})\n{LITTLE_ROOM}{code}"]
    return subprocess.run(words, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize("kind", WRITERS)
@pytest.mark.parametrize("before", [None, b"what was there"])
def test_no_stump_is_left_where_there_is_no_room(tmp_path: Path, kind: str, before: bytes | None) -> None:
    path = tmp_path / "out"
    if before is not None:
        path.write_bytes(before)
    result = full(WRITERS[kind], path)
    assert result.returncode == 1
    assert "File too large" in result.stderr
    assert [file.read_bytes() for file in tmp_path.iterdir()] == ([] if before is None else [before])


def test_a_link_stays_a_link_and_the_file_behind_it_is_written(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "file")
    with whole_text(tmp_path / "link") as out:
        out.write("a\n")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "file").read_text() == "a\n"
    write_png(tmp_path / "deep" / "a.png", NOISE)
    assert np.array_equal(read_grey(tmp_path / "deep" / "a.png"), NOISE)


def test_pipes_and_devices_are_written_to_as_they_stand(tmp_path: Path) -> None:
    with whole_text(Path(os.devnull)) as out:
        out.write("a\n")
    assert not Path(os.devnull).is_file()
    appended = tmp_path / "appended"
    appended.write_text("first\n")
    code = "from sagnode.outfile import whole_text\nwith whole_text(Path('/dev/stdout')) as out: out.write('second\\n')"
    with appended.open("a") as stream:
        words = [sys.executable, "-c", f"from pathlib import Path\n{code}"]
        subprocess.run(words, stdout=stream, check=True, timeout=60)
    assert "second\n" in appended.read_text()
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with subprocess.Popen(["cat", fifo], stdout=subprocess.PIPE) as reader:
        with whole(fifo) as out:
            out.write(b"through")
        assert reader.communicate(timeout=20)[0] == b"through"


@pytest.mark.parametrize("kept", [True, False])
def test_an_interrupt_keeps_what_there_is_only_where_that_is_wanted(tmp_path: Path, kept: bool) -> None:
    path = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt), whole_text(path, keep_interrupted=kept) as out:
        out.write("one line\n")
        raise KeyboardInterrupt
    assert [file.read_text() for file in tmp_path.iterdir()] == ["one line\n"] * kept
