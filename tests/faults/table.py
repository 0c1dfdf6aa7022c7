"""The campaign's tables: one line a kind of fault, one a kind of mutilated input."""

import json
import statistics
from dataclasses import asdict, dataclass, field

HEAD = (
    "fault", "times", "made", "delivered", "lost", "repeated", "false", "recovery, s: median", "greatest", "remarks",
)  # fmt: skip
FUZZ_HEAD = ("input", "times", "refused", "uncaught", "a second", "slowest, s of the processor", "remarks")


@dataclass
class Line:
    """One kind of fault and what came of it.

    ``allowed_repeats``: so many readings were on the wire when their PUBACK was lost, and may come twice.
    ``limit_s``: recovery that is promised.
    ``refused``, ``uncaught``, ``seconds``, ``slowest_s``: of mutilated inputs alone.
    ``inputs``: times it was something mutilated that a running node met, and no fault of its own.
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
    counts: dict = field(default_factory=dict)
    """Of what else the remark tells; those of several nodes are added up."""
    broken: list = field(default_factory=list)
    """Promises that were not kept, a sentence each."""
    in_flight: int = 0
    """Answers of a worker that were not committed yet when the daemon was killed."""
    refused: int = 0
    uncaught: int = 0
    seconds: float = 0.0
    slowest_s: float = 0.0
    inputs: bool = False

    @classmethod
    def of(cls, section, fault, times, books, **more):
        broken = list(books.remarks) + more.pop("broken", [])
        return cls(section, fault, times, books.made, books.delivered, books.lost, books.repeated, books.false,
                   broken=broken, in_flight=books.in_flight, **more)  # fmt: skip

    def add(self, other):
        """The same fault done to another node."""
        for name in ("times", "made", "delivered", "lost", "repeated", "false", "recovery", "allowed_repeats", "broken",
                     "in_flight", "refused", "uncaught"):  # fmt: skip
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.counts = {name: number + other.counts.get(name, 0) for name, number in self.counts.items()}
        self.seconds = max(self.seconds, other.seconds)
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        if other.remark and other.remark != self.remark:
            self.remark = f"{self.remark}; {other.remark}" if self.remark else other.remark

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
        if self.section == "fuzz":
            rate = f"{self.times / self.seconds:.0f}" if self.seconds else "–"
            counts = (self.times, self.refused, self.uncaught)
            return [self.fault, *(str(n) for n in counts), rate, f"{self.slowest_s:.2f}", self.remark]
        median = f"{statistics.median(self.recovery):.2f}" if self.recovery else "–"
        greatest = f"{max(self.recovery):.2f}" if self.recovery else "–"
        counts = (self.times, self.made, self.delivered, self.lost, self.repeated, self.false)
        in_flight = f"{self.in_flight} answers in flight" if self.in_flight else ""
        remark = "; ".join(filter(None, (self.remark, in_flight)))
        return [self.fault, *(str(n) for n in counts), median, greatest, remark]


def save(path, lines, seconds, seed, share, run):
    """Keep a section's lines, so that the others can be run at another time."""
    lines = [asdict(line) for line in lines]
    _write(path, {"run": run, "seconds": seconds, "seed": seed, "share": share, "lines": lines})


def save_run(path, run, names, seconds):
    """Keep how long a run took from its begin to its end, and what was in it."""
    _write(path, {"run": run, "sections": names, "seconds": seconds})


def save_absence(path, why):
    """Remember why a section has no lines."""
    _write(path, {"absent": why})


def _write(path, document):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(document, indent=1))


def load(path):
    """What was saved, its lines as such; where a section was never run, why there is nothing."""
    if not path.exists():
        return {"absent": "not run yet"}
    document = json.loads(path.read_text())
    if "lines" in document:
        document["lines"] = [Line(**line) for line in document["lines"]]
    return document


def markdown(lines):
    """The table of faults, and that of mutilated inputs where there are any."""
    tables = [(HEAD, [line for line in lines if line.section != "fuzz"]),
              (FUZZ_HEAD, [line for line in lines if line.section == "fuzz"])]  # fmt: skip
    return "\n\n".join(_table(head, part) for head, part in tables if part)


def _table(head, lines):
    rows = [list(head), ["---"] + ["---:"] * (len(head) - 2) + ["---"], *(line.cells() for line in lines)]
    total = Line(lines[0].section, "**all**", 0)
    for line in lines:
        total.add(line)
    total.recovery, total.seconds, total.remark = [], 0.0, ""
    rows.append(total.cells())
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)
