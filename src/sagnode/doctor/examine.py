"""The round: every check in the order in which they depend on each other, none of them able to stop the others."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Collection, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from sagnode import __version__
from sagnode.check.configuration import check
from sagnode.config.load import LoadedNode
from sagnode.daemon import places
from sagnode.daemon import report as outside
from sagnode.daemon.uplink import configured_broker
from sagnode.doctor import findings, place, system
from sagnode.doctor.broker import DELIVERY, check_broker
from sagnode.doctor.findings import Finding, Level, fault, ok, skipped, warning
from sagnode.errors import ConfigError
from sagnode.worker.supervisor import START_DEADLINE_S

SCHEMA = "sagnode.doctor/1"
CONFIGURATION, DAEMON, CAMERA = "configuration", "daemon", "camera"


def examine(config: Path, skip: Collection[str] = ()) -> Iterator[Finding]:
    """Look the node over; findings come as they are made.

    Args:
        config: node file or its directory.
        skip: of ``camera``, ``broker`` and ``system``; each is reported as skipped.
    """
    report = check(config)
    loaded = report.loaded if isinstance(report.loaded, LoadedNode) else None
    yield from (fault(CONFIGURATION, str(one)) for one in report.faults)
    yield from (warning(CONFIGURATION, str(one)) for one in report.warnings)
    if report.loaded is not None and loaded is None:
        yield fault(CONFIGURATION, f"{config} is a survey, not a node file", "name the node file")
    if loaded is not None and not report.faults:
        yield ok(CONFIGURATION, f"{loaded.path} and {loaded.span_path}, id {loaded.configuration_id}")
    state_dir = state_dir_of(config)
    said = outside.examine(state_dir) if state_dir.is_dir() else None
    running = bool(said and said["running"])
    yield _daemon(said)
    yield from place.check_state(state_dir, running=running)
    if loaded is None or report.faults:
        yield from (skipped(name, "not looked at, for the configuration has faults") for name in ("camera", "broker"))
    else:
        yield from _sight(loaded, running=running, said=said, with_camera="camera" not in skip)
        yield from _broker(loaded, said if running else None, left_out="broker" in skip)
    if "system" in skip:
        yield skipped("system", "left out, as --skip says")
    else:
        yield from system.check_system()


def document(config: Path, made: list[Finding]) -> dict[str, Any]:
    """The whole of it for a program."""
    count = {level: sum(finding.level is level for finding in made) for level in Level}
    return {
        "schema_version": SCHEMA,
        "at": datetime.now(UTC).isoformat(),
        "software_version": __version__,
        "configuration": str(config),
        "verdict": verdict(made),
        "count": {str(level): number for level, number in count.items()},
        "findings": [finding.as_json() for finding in made],
    }


def verdict(made: list[Finding]) -> str:
    """``fine``, ``warnings`` or ``faults``."""
    if findings.faults(made):
        return "faults"
    return "warnings" if any(finding.level is Level.WARNING for finding in made) else "fine"


def state_dir_of(config: Path) -> Path:
    """Of the node file, however broken that is; then the service's."""
    try:
        return places.configured_state_dir(config)
    except ConfigError:
        return places.SERVICE_STATE


def _daemon(said: dict[str, Any] | None) -> Finding:
    if said is None or said["status"] is None:
        return skipped(DAEMON, "none has run here yet")
    if not said["running"]:
        return skipped(DAEMON, "none is running; " + "; ".join(said["problems"]))
    if said["problems"]:
        return warning(DAEMON, "running; " + "; ".join(said["problems"]), "sagnode status")
    return ok(DAEMON, f"running, fine; sagnode {said['status'].get('software_version', '?')}")


def _sight(loaded: LoadedNode, *, running: bool, said: dict[str, Any] | None, with_camera: bool) -> Iterator[Finding]:
    """Lens, reference picture, camera and a reading, in a process that may hang or die."""
    live = loaded.node.camera.backend != "replay"
    alone = with_camera and not (running and live)
    source = loaded.node.camera
    # The bounds of the camera itself, for each of its calls; then the daemon's own for a start and a reading.
    patience = START_DEADLINE_S + loaded.node.schedule.deadline_s + source.burst * source.burst_interval_s
    words = [sys.executable, "-m", "sagnode.doctor.sight", "--config", str(loaded.path)]
    if not alone:
        words.append("--without-camera")
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        try:
            out, noise = child.communicate(timeout=patience)
            ended = ""
        except subprocess.TimeoutExpired:
            child.kill()
            out, noise = child.communicate()
            ended = f"no end after {patience:.0f} s; killed"
    made = []
    for line in out.splitlines():
        with contextlib.suppress(ValueError, KeyError):
            made.append(Finding.of_json(json.loads(line)))
    yield from made
    if not ended and child.returncode != 0:
        ended = f"killed by signal {-child.returncode}" if child.returncode < 0 else f"status {child.returncode}"
    if ended:
        last = [line for line in noise.splitlines() if line.strip()][-1:]
        remedy = "check the camera's cable and power; run: sagnode capture --config ... --out /tmp/pictures"
        yield fault(CAMERA, f"the process that looks through it ended badly: {'; '.join([ended, *last])}", remedy)
    elif not with_camera:
        yield skipped(CAMERA, "left out, as --skip says")
    elif not alone:
        yield _camera_of_daemon(said)


def _camera_of_daemon(said: dict[str, Any] | None) -> Finding:
    """A camera has one owner; what the daemon says of it counts."""
    page = said["status"] if said else None
    words = str(page["health"].get("camera", "")) if page else ""
    if words.startswith("ok"):
        return ok(CAMERA, f"the daemon has it; {words}")
    if words in {"", "starting", "stopped"}:
        return skipped(CAMERA, f"the daemon has it and says: {words or 'nothing yet'}")
    return fault(CAMERA, f"the daemon has it; {words}", "stop the service and run doctor again to see more")


def _broker(loaded: LoadedNode, said: dict[str, Any] | None, *, left_out: bool) -> Iterator[Finding]:
    mqtt = loaded.node.mqtt
    if left_out:
        yield skipped("broker", "left out, as --skip says")
        return
    if mqtt is None:
        yield skipped("broker", "none is configured; readings are published nowhere")
        return
    password = mqtt.password_file
    if password is not None:
        yield _secret(password)
    broker = configured_broker(mqtt, mqtt.client_id or f"sagnode-{loaded.node.unit.unit}")
    page = said["status"] if said else None
    if page is not None and "broker" not in page["health"]:
        page = None  # nothing that could be understood was shown yet
    daemon_says = (page.get("broker_connected") is True, str(page["health"]["broker"])) if page else None
    yield from check_broker(broker, daemon_says)
    yield _delivery(page)


def _delivery(page: dict[str, Any] | None) -> Finding:
    """A broker may accept the log-in and take no reading; the daemon is the one that sees it."""
    if page is None or page.get("broker_connected") is not True:
        return skipped(DELIVERY, "not tried; whether the broker takes readings shows once the daemon is connected")
    delivery = page["health"].get("delivery", "ok")
    if delivery != "ok":
        what, _, remedy = delivery.rpartition("; ")
        return fault(DELIVERY, what, remedy)
    return ok(DELIVERY, f"the broker takes what it is given; {page['health'].get('outbox_depth', 0)} readings wait")


def _secret(file: Path) -> Finding:
    check = "broker password"
    try:
        mode = file.stat().st_mode
    except PermissionError:
        return skipped(check, f"{file} is in a directory that this user may not look into")
    except OSError as error:
        return fault(check, f"{file}: {error.strerror}", "write the password into it, then chmod 0600")
    if mode & 0o077:
        return warning(check, f"{file} may be read by others (mode {mode & 0o777:04o})", f"chmod 0600 {file}")
    return ok(check, f"{file}, mode {mode & 0o777:04o}")
