"""The end of the campaign: the whole table, what was promised and not kept, and the document."""

import os
import platform
import sys
from datetime import UTC, datetime

from table import load, markdown
from waits import shortened

INTRODUCTION = """# Reliability

What was done to the node on purpose, and what became of its readings. Written by `make faults`
(`tests/faults/campaign.py`, seed {seed}); run it again to get your own. Real processes, a real mosquitto, real files:
the daemon is the shipped one (`sagnode run`), its camera and mathematics are replaced by a stand-in where they would
only cost time. The stand-in's numbers carry a checksum, so that a number that changed on its way would be seen.

- **made**: readings that the journal numbered. **delivered**: acknowledged by the broker and, unless the broker itself
  was killed, received by a subscriber. **lost**: made and never delivered, or a number that is missing in the journal.
  Where the journal's file is damaged on purpose, readings whose own bytes were destroyed are no longer there to be
  delivered: the remarks of those rows count them, and every other one must be found again.
- **repeated**: received more than once; each can be dropped by its `sequence`. Allowed only where a PUBACK was lost or
  had not been written down when the process was killed, and where a command asked for it.
- **false**: a published number that differs from the measured one, or any number in an invalid reading.
- **recovery**: from the fault, or from the moment when the outside world is well again, to the next good reading
  (worker, clock) or the next acknowledgement (broker).
"""

NOTES = """
A reading counts from its commit to the journal. An answer of the worker that was not committed yet when the daemon was
killed, or told to stop, is no reading; the remarks give their number, at most one burst each time. What only memory had
when the power failed, because the disk was missing, is gone from the journal; the remarks count those too.

## What the campaign shortens

A fault that takes minutes at a tower takes seconds here, by configuration or by setting a constant of the daemon in the
process under test. Nothing else of the daemon differs from the shipped one.

{waits}

With the shipped values stand: one broker that is away for longer than the longest pause between two attempts, the
worker's first restart, the limits of memory, and the commits themselves (`synchronous=FULL`).

## What is not shown

A real SD card's firmware and wear; the brown-outs of a Raspberry Pi; drivers that hang in the kernel (state D); a
hardware watchdog that fires (`tests/platform` boots machines; here the request for a reboot is the end). The disk of
the power cuts, the virtual machine's too, is a real ext4 over a file in user space that forgets a random half of the
sectors that were not flushed. It forgets as a card's cache does, but never damages what was flushed, as a worn card
may; for that the journal's own files are damaged in the rows above. A missing disk is known by `/etc/fstab`, or by the
mark that the service leaves in the directory that systemd gives it; a node started by hand whose mount stands in
neither looks like a new one. The month of backlog is a month of readings, not of time. Mutilated pictures are judged by
whether they are refused or read, not by what is read.

Where it was run: Python {python}, {machine}, {cores} processors with a load of {load:.0f} (times grow with what else
a machine does), {when}.
"""


def conclude(names, results, args):
    """Print everything that was ever run; returns the exit code."""
    lines, broken, seeds, parts, absent, seconds = [], [], set(), [], {}, 0.0
    for name in names:
        found = load(results / f"{name}.json")
        if "absent" in found:
            absent[name] = found["absent"]
            continue
        lines += found["lines"]
        seeds.add(found["seed"])
        seconds += found["seconds"]
        broken += [sentence for line in found["lines"] for sentence in line.verdict()]
        part = f", {found['share']:.0%} of its faults" if found["share"] != 1.0 else ""
        parts.append(f"{name} {found['seconds']:.0f} s{part}")
    for name, why in absent.items():
        print(f"NOT IN THE TABLE: {name}: {why}")
    print(markdown(lines))
    for sentence in broken:
        print(f"BROKEN: {sentence}")
    if args.report:
        text = INTRODUCTION.format(seed=", ".join(map(str, sorted(seeds))))
        text += f"\n{provenance(names, results)}\n\n{summary(lines)}\n\n{markdown(lines)}\n\n"
        text += f"Time: {seconds / 60:.0f} minutes of sections, {args.jobs} at once ({'; '.join(parts)}).\n"
        text += "".join(f"\nNot in the table: {name}, {why}.\n" for name, why in absent.items())
        text += "".join(f"\n**Not kept:** {sentence}.\n" for sentence in broken)
        text += NOTES.format(
            waits=shortened(),
            python=platform.python_version(),
            machine=platform.machine(),
            load=os.getloadavg()[2],
            cores=len(os.sched_getaffinity(0)),
            when=datetime.now(UTC).date().isoformat(),
        )
        args.report.write_text(text)
    print("ALL KEPT" if not broken and not absent else f"{len(broken)} broken, {len(absent)} not run", file=sys.stderr)
    return 1 if broken or any("broke down" in why or "time" in why for why in absent.values()) else 0


def provenance(names, results):
    """Whether all of it is one run, of which commit and how long; else which section is of which run."""
    runs = {}
    for name in names:
        found = load(results / f"{name}.json")
        if "absent" not in found:
            runs.setdefault(found["run"], []).append(name)
    whole = load(results / "run.json")
    if [whole.get("run")] == list(runs) and set(whole["sections"]) == set(names):
        return f"One run of all sections, {whole['seconds'] / 60:.0f} minutes without a break (commit {whole['run']})."
    parts = "; ".join(f"{', '.join(sections)}: commit {run}" for run, sections in runs.items())
    return f"Sections can be run again one by one (`make faults ONLY=disk`), and were: {parts}."


def summary(lines):
    """What the issue of the campaign asks for, in one paragraph."""
    faults = [line for line in lines if line.section != "fuzz" and not line.inputs]
    inputs = [line for line in lines if line.section == "fuzz" or line.inputs]
    total = {name: sum(getattr(line, name) for line in lines) for name in ("made", "lost", "repeated", "false")}
    kills = sum(line.times for line in lines if line.section == "kill")
    return (
        f"**{sum(line.times for line in faults)} faults**, of them {kills} `kill -9` at random moments;\n"
        f"{total['made']} readings made, **{total['lost']} lost**, **{total['false']} false**, {total['repeated']}"
        f" repeated.\n{sum(line.times for line in inputs)} mutilated inputs,"
        f" **{sum(line.uncaught for line in inputs)} uncaught exceptions**."
    )
