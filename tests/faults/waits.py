"""What the campaign shortens: each wait with the value under test and the shipped one, read from the program itself."""

import tomllib
from importlib import import_module
from importlib.resources import files

from sagnode.config.node import Commands, Mqtt, Recovery, Schedule
from sagnode.config.node import Worker as WorkerTable

CONSTANTS = {
    "daemon.link.BACKOFF_MAX_S": ("1 s", "longest pause between two attempts to reach the broker", "all but one"),
    "daemon.session.PUBACK_WAIT_S": ("1 s", "wait for an acknowledgement before the link is given up", "broker"),
    "daemon.store.DISTRUST_AFTER_S": ("1 s", "a disk that refuses for so long is left", "disk"),
    "daemon.store.LOOK_AGAIN_S": ("0.5 s", "between two looks whether it is well again", "disk"),
}
FIELDS = (
    ("schedule.interval_s", Schedule, "interval_s", "0.1 to 0.2 s (1 s: backlog); or as fast as it can", "all"),
    ("schedule.deadline_s", Schedule, "deadline_s", "5 s; camera 20 s; 0.2 and 0.4 s where the worker hangs", "all"),
    ("worker.backoff_max_s", WorkerTable, "backoff_max_s", "0.2 s", "all"),
    ("mqtt.backlog_per_s", Mqtt, "backlog_per_s", "2000", "all"),
    ("mqtt.inflight", Mqtt, "inflight", "20", "all"),
    ("recovery.restart_after_s", Recovery, "restart_after_s", "0.5 s", "reload (ladder)"),
    ("recovery.restarts_before_reboot", Recovery, "restarts_before_reboot", "2", "reload (ladder)"),
    ("recovery.reboot_wait_h", Recovery, "reboot_wait_h", "0.0001", "reload (ladder)"),
    ("commands.per_minute", Commands, "per_minute", "600 (12: flood)", "commands"),
)  # fmt: skip


def shortened():
    """The table as Markdown."""
    rows = [("wait or limit", "here", "shipped", "sections"), ("---",) * 4]
    rows += [(f"`{name}`", here, _shipped(table, key), where) for name, table, key, here, where in FIELDS]
    for name, (here, what, where) in CONSTANTS.items():
        module, _, constant = name.rpartition(".")
        value = getattr(import_module(f"sagnode.{module}"), constant)
        rows.append((f"`{constant}` ({module}): {what}", here, f"{value:g} s", where))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _shipped(table, key):
    default = table.model_fields[key].default
    if default is None:  # the interval: `sagnode config init` writes one
        template = (files("sagnode.config") / "templates" / "node.toml").read_text()
        default = tomllib.loads(template)["schedule"][key]
    return f"{default:g}"
