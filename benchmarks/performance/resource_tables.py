"""Sections on memory, idle cost, and where the remaining time goes."""

from __future__ import annotations

from typing import Any

from performance.frames import NAMES
from performance.prose import flow
from performance.proxy import HEADERS

NETWORK_SEGMENT = 1400
PER_HOUR = 12
"""Readings at one in five minutes."""
MB = 1024.0
CARD_BYTES = 32e9
CARDS = (
    (
        "a card for continuous recording, by its maker's claim of 17 520 h at 26 Mbit/s",
        17520 * 3600 * 26e6 / 8,
    ),
    ("a cheap card of four-bit cells, 100 times its capacity", 100 * CARD_BYTES),
)
"""Bytes that 32 GB may be written. Samsung PRO Endurance: 16 years at 26 Mbit/s for 256 GB, in proportion to capacity
(geeksaresexy.net/2022/05/05); four-bit flash: 100 to 1000 cycles (techrepublic.com, Micron's 1 TB industrial card)."""
METHOD_NAMES = {
    "literal": "paper, literal (any number of templates, one after the other)",
    "anchored": "exact, anchored, 300 templates",
    "reading": "sagnode, one frame",
    "burst": "sagnode, burst of 8",
}


def memory_section(results: dict[str, Any]) -> str:
    """Peaks, soaks and ``sagnode status``."""
    lines = ["## Memory", "", "Peak of resident memory above what was there with libraries and picture loaded, MB:", ""]
    lines += ["| method | " + " | ".join(NAMES) + " |", "|---|" + "---|" * len(NAMES)]
    for method, name in METHOD_NAMES.items():
        rows = (results["methods"][view][method] for view in NAMES)
        lines.append(f"| {name} | " + " | ".join(f"{(r['peak_kb'] - r['before_kb']) / MB:.1f}" for r in rows) + " |")
    lines += ["", "The real worker process, started by the daemon's own supervisor; frames come from JPEG files:", ""]
    lines += ["| frames | ready, MB | peak, MB | after, MB |", "|---|---|---|---|"]
    workers = {f"{view}, one a reading": results["worker"][view] for view in NAMES}
    workers["field, burst of 8"] = results["worker_burst"]
    lines += [
        f"| {name} | {w['ready_kb'] / MB:.0f} | {w['peak_kb'] / MB:.0f} | {w['after_kb'] / MB:.0f} |"
        for name, w in workers.items()
    ]
    lines += ["", "Over many readings, slope of resident memory after the first quarter of them:", ""]
    lines += ["| process | readings | MB at the end | kB more for every 1 000 readings |", "|---|---|---|---|"]
    for name, key in (
        ("daemon with journal and broker (a stand-in measures)", "daemon_soak"),
        ("worker, laboratory frames", "worker_soak"),
    ):
        soak = results[key]
        slope = soak["slope"]
        lines.append(
            f"| {name} | {soak['readings']:,} | {slope['last'] / MB:.1f}"
            f" | {slope['per_thousand']:+.0f} ± {slope['u']:.0f} |"
        )
    status = results["status"]
    heavy = ", ".join(status["imported"]) or "neither NumPy nor OpenCV, nor pydantic, APScheduler or paho"
    lines += [
        "",
        flow(
            f"""`sagnode status` takes {1e3 * status["wall_s"]:.0f} ms of wall time ({1e3 * status["cpu_s"]:.0f} ms CPU;
            the bare interpreter {1e3 * status["bare_s"]:.0f} ms) and imports {heavy}."""
        ),
        "",
    ]
    return "\n".join(lines)


def idle_section(results: dict[str, Any], memory: dict[str, Any] | None = None) -> str:
    """CPU, network and disk at one reading in five minutes.

    What the daemon does for a reading is less than its waiting varies by; where the soak has measured it over many
    readings, that counts.
    """
    waiting, disk = results["waiting"], results["disk"]
    rate, reading = waiting["rate"], waiting["reading"]
    lines = [
        "## Idle cost",
        "",
        flow(
            f"""One reading every five minutes, burst of {waiting["burst"]}, {waiting["conductors"]} conductors,
            1456x1088, real daemon, worker and broker on the system's clock."""
        ),
        "",
        "| CPU s an hour | waiting | readings | together |",
        "|---|---|---|---|",
    ]
    for name in ("daemon", "worker"):
        each = memory["daemon_soak"]["cpu_s_each"] if memory and name == "daemon" else reading[f"{name}_s"]
        wait, work = 3600 * rate[f"{name}_s"], PER_HOUR * max(0.0, each)
        lines.append(f"| {name} | {wait:.1f} | {work:.1f} | {wait + work:.1f} |")
    # loopback carries 64 KiB in one packet, a real network some 1400 bytes
    packets = max(reading["segments_up"], reading["up"] / NETWORK_SEGMENT)
    on_the_wire = reading["up"] + HEADERS * packets
    monthly = PER_HOUR * 24 * 30 * on_the_wire
    lines += [
        "",
        flow(
            f"""Sent for each reading: {reading["up"]:,.0f} bytes of MQTT in some {packets:.0f} packets,
            {on_the_wire:,.0f} bytes with IPv4 and TCP headers, {monthly / 1e6:.0f} MB a month (TLS adds
            some 30 bytes a packet). Received: {reading["down"]:,.0f} bytes."""
        ),
        "",
        flow(
            """Written to disk for each reading (one transaction for its conductors, one for what the broker has
            confirmed; the file system is flushed after each, as five minutes of quiet do; checkpoints included):"""
        ),
        "",
        "| bytes | |",
        "|---|---|",
        f"| {disk['json_bytes']:,.0f} | the readings themselves |",
        f"| {disk['journal_bytes']:,.0f} | growth of the journal's file |",
        f"| {disk['process_bytes']:,.0f} | handed to the storage layer by the daemon (`/proc/PID/io`) |",
    ]
    if "device_bytes" in disk:
        each = disk["device_bytes"]
        lines.append(
            f"| {each:,.0f} | written to the block device by ext4 (`/sys/block/*/stat`),"
            f" in {disk['device_requests']:.1f} requests |"
        )
    else:
        each = disk["process_bytes"]
    yearly = each * PER_HOUR * 24 * 365
    lines += ["", f"That is {yearly / 1e9:.1f} GB a year. A 32 GB card lasts", ""]
    for name, endurance in CARDS:
        lines.append(f"- {name} ({endurance / 1e12:.1f} TB): {endurance / yearly:,.0f} years.")
    if "device_requests" in disk:
        coarse = disk["device_requests"] * 65536 * PER_HOUR * 24 * 365
        lines += [
            "",
            flow(
                f"""Cards write larger units than they are given. Were every request to cost 64 KiB inside the card, it
                would be {coarse / 1e9:.0f} GB a year, and the cheap card would last {CARDS[-1][1] / coarse:,.0f}
                years. What the rest of the system writes (its log above all) is not in these numbers."""
            ),
        ]
    return "\n".join([*lines, ""])


def profile_section(results: dict[str, Any]) -> str:
    """The largest items of the profile, and the floor."""
    lines = ["## Where the remaining time goes", ""]
    for view, found in results.items():
        floor = found["floor"]
        lines += [
            f"### {view}: {found['conductors']} conductors, {found['cpu_ms']:.1f} ms",
            "",
            "| function | own ms | with callees, ms |",
            "|---|---|---|",
        ]
        lines += [f"| `{row['name']}` | {row['own_ms']:.1f} | {row['cumulative_ms']:.1f} |" for row in found["top"]]
        kinds = ", ".join(f"{name} {ms:.0f} ms" for name, ms in found["kinds"].items())
        lines += [
            "",
            flow(f"""From {found["samples"]:,} looks by py-spy. A function's own time has NumPy's and OpenCV's functions
            in it that it calls. By the innermost frame: {kinds}."""),
            "",
            "The floor:",
            "",
            "| by itself | ms |",
            "|---|---|",
        ]
        lines += [f"| {words} | {ms:.2f} |" for words, ms in floor]
        lines.append("")
    return "\n".join(lines)
