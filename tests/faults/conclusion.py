"""The end of the campaign: the whole table, what was promised and not kept, and the document."""

import platform
import sys

from table import load, markdown

INTRODUCTION = """# Reliability

What was done to the node on purpose, and what became of its readings. Written by `make faults`
(`tests/faults/campaign.py`, seed {seed}); run it again to get your own. Real processes, a real mosquitto, real files:
the daemon is the shipped one (`sagnode run`), its camera and mathematics are replaced by a stand-in where they would
only cost time. The stand-in's numbers carry a checksum, so that a number that changed on its way would be seen.

- **made**: readings that the journal numbered. **delivered**: acknowledged by the broker and, unless the broker itself
  was killed, received by a subscriber. **lost**: made and never delivered, or a number that is missing in the journal.
- **repeated**: received more than once; each can be dropped by its `sequence`. Allowed only where a PUBACK was lost or
  had not been written down when the process was killed.
- **false**: a published number that differs from the measured one, or any number in an invalid reading.
- **recovery**: from the fault, or from the moment when the outside world is well again, to the next good reading
  (worker, clock) or the next acknowledgement (broker).
"""

NOTES = """
A reading counts from its commit to the journal. An answer of the worker that was not committed yet when the daemon was
killed is no reading; the remarks give their number, at most one burst a kill.

Where it was run: Python {python}, {machine}, {when}. What cannot be shown here: a real SD card's firmware, a Raspberry
Pi's brown-outs, and drivers that hang in the kernel.
"""


def conclude(names, results, args, skipped):
    """Print everything that was ever run; returns the exit code."""
    lines, seconds, broken, seeds = [], 0.0, [], set()
    parts = []
    for name in names:
        found = load(results / f"{name}.json")
        if found is None:
            skipped.setdefault(name, "not run yet")
            continue
        lines += found[0]
        seconds += found[1]
        seeds.add(found[2])
        broken += [sentence for line in found[0] for sentence in line.verdict()]
        part = f", {found[3]:.0%} of its faults" if found[3] != 1.0 else ""
        parts.append(f"{name} {found[1]:.0f} s{part}")
    for name, why in skipped.items():
        print(f"NOT IN THE TABLE: {name}: {why}")
    print(markdown(lines))
    for sentence in broken:
        print(f"BROKEN: {sentence}")
    if args.report:
        from datetime import UTC, datetime

        text = INTRODUCTION.format(seed=", ".join(map(str, sorted(seeds))))
        text += f"\n{markdown(lines)}\n\n" + f"Time: {seconds / 60:.0f} minutes ({'; '.join(parts)}).\n"
        text += "".join(f"\nNot run here: {name}, {why}.\n" for name, why in skipped.items())
        text += "".join(f"\n**Not kept:** {sentence}.\n" for sentence in broken)
        text += NOTES.format(
            python=platform.python_version(), machine=platform.machine(), when=datetime.now(UTC).date().isoformat()
        )
        args.report.write_text(text)
    print(
        "ALL KEPT" if not broken and not skipped else f"{len(broken)} broken, {len(skipped)} not run", file=sys.stderr
    )
    return 1 if broken or any(why == "broke down" for why in skipped.values()) else 0
