"""A broker for the demonstration: mosquitto where it is installed, else amqtt; a child process on loopback."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Self

from sagnode.errors import SagnodeError
from sagnode.worker.confine import die_with_parent

_START_S = 15.0
_STOP_S = 5.0


class EmbeddedBroker:
    """Use as a context manager; afterwards nothing of it is left running.

    Args:
        directory: for its configuration and log; made if need be.
        prefer: ``mosquitto`` or ``amqtt`` to insist on one.

    Raises:
        SagnodeError: neither is installed, or it does not start.
    """

    def __init__(self, directory: Path, prefer: str | None = None) -> None:
        self._directory = directory
        self.kind = prefer or ("mosquitto" if _mosquitto() else "amqtt")
        self.port = 0
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def mqtt5(self) -> bool:
        """Whether it speaks MQTT 5; amqtt speaks 3.1.1."""
        return self.kind == "mosquitto"

    def __enter__(self) -> Self:
        """Start and wait until it listens."""
        self._directory.mkdir(parents=True, exist_ok=True)
        for _ in range(3):  # the free port may be taken by somebody else before the broker has it
            self.port = _free_port()
            if self._start():
                return self
        log = self._directory / "broker.log"
        raise SagnodeError(f"the demonstration's broker ({self.kind}) does not start", f"its words are in {log}")

    def __exit__(self, *exc: object) -> None:
        """Stop it."""
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(_STOP_S)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def _start(self) -> bool:
        parent = os.getpid()
        with (self._directory / "broker.log").open("wb") as log:
            self._process = subprocess.Popen(
                self._command(),
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,  # Ctrl-C is for the driver, which ends it afterwards
                preexec_fn=lambda: None if die_with_parent(parent) else os._exit(1),  # no threads yet
            )
        until = time.monotonic() + _START_S
        while time.monotonic() < until and self._process.poll() is None:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1.0):
                return True
            time.sleep(0.05)
        self.__exit__()
        return False

    def _command(self) -> list[str]:
        if self.kind == "mosquitto":
            program = _mosquitto()
            if program is None:
                raise SagnodeError("mosquitto is not installed", "apt install mosquitto")
            lines = [f"listener {self.port} 127.0.0.1", "allow_anonymous true", "persistence false"]
            lines += ["max_queued_messages 0", "log_type error", "log_type warning"]
            # Started by root, it would change to a user that may not exist here.
            lines += ["user root"] if os.geteuid() == 0 else []
            configuration = self._directory / "mosquitto.conf"
            configuration.write_text("\n".join(lines) + "\n", encoding="utf-8")
            return [program, "-c", str(configuration)]
        if importlib.util.find_spec("amqtt") is None:
            remedy = 'apt install mosquitto, or pip install "sagnode[demo]", or configure a broker with [mqtt]'
            raise SagnodeError("there is no broker for the demonstration", remedy)
        return [sys.executable, "-m", "sagnode.demo.amqtt_broker", str(self.port)]


def _mosquitto() -> str | None:
    # Debian puts it where an ordinary user's PATH does not look.
    return shutil.which("mosquitto", path=os.pathsep.join([os.environ.get("PATH", ""), "/usr/sbin", "/usr/local/sbin"]))


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
