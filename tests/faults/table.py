"""The campaign's table: one line a kind of fault."""

import json
import statistics
from dataclasses import asdict, dataclass, field

HEAD = (
    "fault", "times", "made", "delivered", "lost", "repeated", "false", "recovery, s: median", "greatest", "remarks",
)  # fmt: skip


@dataclass
class Line:
    """One kind of fault and what came of it.

    ``allowed_repeats``: so many readings were on the wire when their PUBACK was lost, and may come twice.
    ``limit_s``: recovery that is promised.
    """

    section: str
    fault: str
    times: int
    made: int = 0
    delivered: int = 0
    lost: int = 0
    repeated: int = 0
    false: int = 0
    recovery: list = field(default_factory=list)
    allowed_repeats: int = 0
    limit_s: float | None = None
    remark: str = ""
    broken: list = field(default_factory=list)
    """Promises that were not kept, a sentence each."""

    @classmethod
    def of(cls, section, fault, times, books, **more):
        broken = list(books.remarks) + more.pop("broken", [])
        return cls(section, fault, times, books.made, books.delivered, books.lost, books.repeated, books.false,
                   broken=broken, **more)  # fmt: skip

    def verdict(self):
        """Sentences for what was promised and not kept."""
        said = list(self.broken)
        if self.lost:
            said.append(f"{self.lost} readings lost")
        if self.false:
            said.append(f"{self.false} false numbers")
        if self.repeated > self.allowed_repeats:
            said.append(f"{self.repeated} repeated, and only {self.allowed_repeats} can have lost their PUBACK")
        if self.limit_s is not None and max(self.recovery, default=0) > self.limit_s:
            said.append(f"recovery took {max(self.recovery):.1f} s, promised are {self.limit_s:g} s")
        return [f"{self.section}, {self.fault}: {sentence}" for sentence in said]

    def cells(self):
        median = f"{statistics.median(self.recovery):.2f}" if self.recovery else "–"
        greatest = f"{max(self.recovery):.2f}" if self.recovery else "–"
        counts = (self.times, self.made, self.delivered, self.lost, self.repeated, self.false)
        return [self.fault, *(str(n) for n in counts), median, greatest, self.remark]


def save(path, lines, seconds, seed, share):
    """Keep a section's lines, so that the others can be run at another time."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(
        json.dumps(
            {"seconds": seconds, "seed": seed, "share": share, "lines": [asdict(line) for line in lines]}, indent=1
        )
    )


def load(path):
    """The lines of a section, its seconds, its seed and its share of the faults; None when it was never run."""
    if not path.exists():
        return None
    document = json.loads(path.read_text())
    return [Line(**line) for line in document["lines"]], document["seconds"], document["seed"], document["share"]


def markdown(lines):
    rows = [list(HEAD), ["---"] + ["---:"] * (len(HEAD) - 2) + ["---"], *(line.cells() for line in lines)]
    total = Line("", "**all**", *(sum(getattr(line, name) for line in lines) for name in (
        "times", "made", "delivered", "lost", "repeated", "false")))  # fmt: skip
    rows.append(total.cells())
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)
