"""A node that replays two frames of the demonstration at noon, and the real broker of the daemon's tests."""

import shutil
from pathlib import Path

import pytest

DEMO = Path(__file__).parents[2] / "src" / "sagnode" / "demo" / "site"

NODE = """
span_file = "span.toml"
[unit]
utility = "u"
line = "l"
span = "span-41-42"
unit = "n1"
[camera]
backend = "replay"
replay = {{ path = "frames", at_end = "loop" }}
[schedule]
interval_s = 300
[storage]
state_dir = "state"
{more}
"""


@pytest.fixture
def node(tmp_path):
    """Writes the node file, with more tables on request; returns its directory."""
    directory = tmp_path / "node"
    (directory / "frames").mkdir(parents=True)
    (directory / "state").mkdir()
    for name in ("span.toml", "camera.yaml", "reference.jpg"):
        shutil.copy(DEMO / name, directory)
    for hour in (12, 13):
        shutil.copy(DEMO / "frames" / f"20260621T{hour}0000Z.jpg", directory / "frames")

    def write(more=""):
        (directory / "node.toml").write_text(NODE.format(more=more))
        return directory

    return write
