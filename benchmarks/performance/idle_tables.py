"""The section on what a node costs that waits most of the time."""

from __future__ import annotations

from typing import Any

from performance.prose import flow, told
from performance.proxy import HEADERS

PER_HOUR = 12
"""Readings at one in five minutes."""
PER_MONTH = PER_HOUR * 24 * 30
PER_YEAR = PER_HOUR * 24 * 365
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
LONG_YEARS = 100
"""A card that would last longer ends by something else."""
MESSAGES = {"measurement": "readings, one message a conductor", "health": "health"}


def idle_section(results: dict[str, Any]) -> str:
    """CPU, network and disk at one reading in five minutes."""
    waiting = results["waiting"]
    lines = [
        "## Idle cost",
        "",
        flow(
            f"""One reading every five minutes, burst of {waiting["burst"]}, {waiting["conductors"]} conductors,
            1456x1088; the real daemon, worker and broker on the system's clock. Measured over {waiting["readings"]}
            readings {waiting["interval_s"]:.0f} s apart and the waiting between them; ± is the standard uncertainty
            from the scatter between them. The start is not in it: until the first reading was written down it took
            {waiting["start"]["daemon"]:.1f} s of CPU in the daemon and {waiting["start"]["worker"]:.1f} s in the
            worker, once."""
        ),
        "",
        "| CPU s an hour | waiting | 12 readings | together |",
        "|---|---|---|---|",
    ]
    lines += [_cpu_row(name, share) for name, share in waiting["cpu"].items()]
    lines += ["", *_network(waiting), "", *_disk(results["disk"])]
    return "\n".join([*lines, ""])


def _cpu_row(name: str, share: dict[str, float]) -> str:
    rest, rest_u = 3600 * share["rest_per_s"], 3600 * share["rest_u"]
    work, work_u = PER_HOUR * share["each"], PER_HOUR * share["each_u"]
    both = told(rest + work, (rest_u**2 + work_u**2) ** 0.5)
    return f"| {name} | {told(rest, rest_u)} | {told(work, work_u)} | {both} |"


def _network(waiting: dict[str, Any]) -> list[str]:
    """By message, as the proxy between daemon and broker saw them in the windows of the readings."""
    network = waiting["network"]
    messages = network["messages"]
    lines = ["| sent for each reading | messages | bytes of MQTT |", "|---|---|---|"]
    for name, words in MESSAGES.items():
        row = messages.get(name, {"count": 0.0, "bytes": 0.0})
        lines.append(f"| {words} | {row['count']:.0f} | {row['bytes']:,.0f} |")
    bytes_ = sum(messages[name]["bytes"] for name in MESSAGES if name in messages)
    on_the_wire = bytes_ + HEADERS * network["packets"]
    # asks and is answered, and the answer is acknowledged
    alive = (2 + HEADERS + HEADERS) * 3600 / waiting["keepalive_s"] / PER_HOUR
    month = PER_MONTH * (on_the_wire + alive)
    return [
        *lines,
        "",
        flow(
            f"""With acknowledgements that makes {network["packets"]:.0f} packets and, with IPv4 and TCP headers,
            {on_the_wire:,.0f} bytes; {month / 1e6:.0f} MB a month, a keep-alive every {waiting["keepalive_s"]} s
            included. TLS adds some 30 bytes a packet. The broker's answers are {network["down"]:.0f} bytes of MQTT a
            reading."""
        ),
    ]


def _disk(disk: dict[str, Any]) -> list[str]:
    lines = [
        flow(
            f"""Written to disk for each reading, the mean of {disk["cycles"]:,} (one transaction for its conductors,
            one for what the broker has confirmed; the file system is flushed after each, as five minutes of quiet do;
            checkpoints included):"""
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
    yearly = each * PER_YEAR
    lines += ["", f"That is {yearly / 1e9:.1f} GB a year. A 32 GB card, worn by nothing else, lasts", ""]
    lines += [f"- {name} ({endurance / 1e12:.1f} TB): {_years(endurance / yearly)}." for name, endurance in CARDS]
    rest = """What the rest of the system writes (its log above all), pictures, and the file of the landmarks'
        appearances (anew once an hour at most, where there is something new) are not in these numbers."""
    if "device_requests" in disk:
        coarse = disk["device_requests"] * 65536 * PER_YEAR
        rest = f"""Cards write larger units than they are given. Were every request to cost 64 KiB inside the card, it
            would be {coarse / 1e9:.0f} GB a year, and the cheap card would last {_years(CARDS[-1][1] / coarse)}.
            {rest}"""
    return [*lines, "", flow(rest)]


def _years(years: float) -> str:
    """No false precision: beyond a century it is not the writing that ends a card."""
    return f"{years:,.0f} years" if years < LONG_YEARS else f"more than {LONG_YEARS} years ({years:.2g} by this alone)"
