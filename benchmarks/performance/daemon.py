"""The real daemon with :mod:`performance.stand_in` for a worker: ``benchmarks/performance/daemon.py NODE.TOML``."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the folder of this package

from performance.stages import replaced
from sagnode.config.load import load_node
from sagnode.daemon import logs
from sagnode.daemon.node import run
from sagnode.worker.process import CommandLine

STAND_IN = Path(__file__).with_name("stand_in.py")


def command_line(_config: Path, _album: Path | None = None) -> CommandLine:
    """In the place of the real worker's."""

    def build(requests_fd: int, replies_fd: int, resume_after: datetime | None) -> Sequence[str]:
        words = [sys.executable, str(STAND_IN), "--requests-fd", str(requests_fd), "--replies-fd", str(replies_fd)]
        words += ["--parent", str(os.getpid())]
        return words if resume_after is None else [*words, "--resume-after", resume_after.isoformat()]

    return build


def main() -> int:
    loaded = load_node(Path(sys.argv[1]))
    logs.set_up(loaded.node.log_level)
    with replaced("sagnode.daemon.node", "command_line", command_line):
        return run(loaded)


if __name__ == "__main__":
    sys.exit(main())
