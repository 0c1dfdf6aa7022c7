"""Runs the lanes that need whole machines, and writes what they showed into docs/platform.md.

    python tests/platform/lanes.py [LANE ...]      all of them, or those that are named; --list names them
    python tests/platform/lanes.py --possible LANE ...    those that this machine can run; for continuous integration

A lane that lacks something is told with what to install and counts as failed: nothing is passed over in silence. What a
lane showed last is kept in build/platform, so that one lane may be run alone. With --possible such a lane is told as
"skipped: needs ..." and does not count, and the document is left alone. JOBS=2 of them run beside each other.
"""

from __future__ import annotations

import json
import os
import platform
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from datetime import UTC, datetime
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from lane_list import Lane, lacking, lanes

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "build" / "platform"
DOCUMENT = ROOT / "docs" / "platform.md"
SKIPPED = 77
"""How a command says that this machine cannot show it; its last line says what is missing."""
MERCY_S = 20.0
BEGIN, END = "<!-- made by tests/platform/lanes.py -->", "<!-- end -->"
Result = dict[str, object]


def run(lane: Lane) -> Result:
    """Run one lane to its end, or to its limit, and return what it showed."""
    began, lines = time.monotonic(), []
    missing = lacking(lane)
    result = f"not run: needs {missing}" if missing else "fine"
    log = KEPT / f"{lane.name}.log"
    log.unlink(missing_ok=True)
    for command in () if missing else lane.commands:
        left_s = lane.limit_s - (time.monotonic() - began)
        status, said = _tee(lane, command, log, left_s)
        lines += list(_shown(said))
        if status is None:
            result = f"not run: needs more than its {lane.limit_s:.0f} s on this machine"
        elif status == SKIPPED and said:
            result = f"not run: needs {said[-1].removeprefix('skipped: needs ')}"
        elif status:
            result = "FAILED"
        if status != 0:
            break
    return {
        "lane": lane.name,
        "shows": lane.shows,
        "result": result,
        "took_s": round(time.monotonic() - began),
        "at": datetime.now(UTC).strftime("%Y-%m-%d"),
        "commit": _commit(),
        "lines": lines,
    }


def _tee(lane: Lane, command: tuple[str, ...], log: Path, limit_s: float) -> tuple[int | None, list[str]]:
    """Run a command, its output also to a file; returns its exit status (None: out of time) and its lines."""
    said, late = [], threading.Event()
    environment = {**os.environ, **dict(lane.environment)}
    pipe = subprocess.PIPE
    with (
        log.open("a", encoding="utf-8") as file,
        subprocess.Popen(
            command, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, stdout=pipe, stderr=subprocess.STDOUT,
            text=True, errors="replace", start_new_session=True,
        ) as child,
    ):  # fmt: skip
        watch = threading.Timer(max(0.0, limit_s), _end, (child, late))
        watch.start()
        for line in child.stdout or ():
            print(f"{lane.name} | {line.rstrip()}", flush=True)
            file.write(line)
            said.append(line.rstrip())
        child.wait()
        watch.cancel()
    return None if late.is_set() else child.returncode, said


def _end(child: subprocess.Popen[str], late: threading.Event) -> None:
    """End a command with everything that it started."""
    late.set()
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(child.pid, number)
            child.wait(MERCY_S)
        except (ProcessLookupError, subprocess.TimeoutExpired):
            continue


def _shown(lines: list[str]) -> Iterator[str]:
    """The lines that say something: a lane's own findings, and not those of doctor, which have a column more."""
    for line in lines:
        if re.match(r"(ok    \S|FAIL  )", line):
            yield re.sub(r"\s+", " ", line.removeprefix("ok    "))
        elif re.match(
            r"systemd \d+, Python|.*\.deb: \d+ MB|readings of|stalled:|reopened|scenes:|→ Overall|\d+ passed", line
        ):
            yield line.replace(f"{ROOT}/", "").strip()


def _commit() -> str:
    """The commit, marked where something is not in it."""
    git = ("git", "-C", str(ROOT))
    head = subprocess.run(
        [*git, "log", "-1", "--format=%h"], capture_output=True, text=True, check=False
    ).stdout.strip()
    clean = (
        subprocess.run([*git, "diff", "--quiet", "HEAD", "--", ".", ":!docs/platform.md"], check=False).returncode == 0
    )
    return head if clean else f"{head} and changes"


def run_all(names: list[str], jobs: int) -> Iterator[Result]:
    """Run lanes beside each other where they share no root, in their order; yields each result when it is there."""
    waiting = [lane.name for lane in lanes() if lane.name in names]
    running: dict[Future[Result], Lane] = {}
    with ThreadPoolExecutor(jobs) as pool:
        while waiting or running:
            # Anew each time: what a lane has still to do depends on what others have left behind.
            for lane in [lane for lane in lanes() if lane.name in waiting]:
                busy = [other for other in running.values() if other.uses & lane.uses]
                awaited = set(lane.after) & {*waiting, *(other.name for other in running.values())}
                if len(running) < jobs and not busy and not awaited:
                    print(f"--- lane {lane.name}: {lane.shows}", flush=True)
                    waiting.remove(lane.name)
                    running[pool.submit(run, lane)] = lane
            for done in wait(running, return_when=FIRST_COMPLETED).done:
                del running[done]
                yield done.result()


def write_document() -> None:
    """The table, and below it what each lane said, between the marks of docs/platform.md."""
    found = [json.loads(file.read_text()) for lane in lanes() if (file := KEPT / f"{lane.name}.json").exists()]
    rows = ["| lane | shows | result | s | on | commit |", "|---|---|---|---|---|---|"]
    columns = ("lane", "shows", "result", "took_s", "at", "commit")
    rows += ["| " + " | ".join(str(one[column]) for column in columns) + " |" for one in found]
    machine = f"Linux {platform.release().split('-')[0]} on {platform.machine()}, {os.cpu_count()} processors, {_os()}"
    text = [f"Run on {machine}, shared with other work: the times are upper bounds.{_whole(found)}", "", *rows]
    for one in found:
        if one["lines"]:
            text += ["", f"**{one['lane']}**", "", *(f"- {line}" for line in one["lines"])]
    document = DOCUMENT.read_text(encoding="utf-8")
    before, _, rest = document.partition(BEGIN)
    after = rest.partition(END)[2]
    DOCUMENT.write_text(f"{before}{BEGIN}\n" + "\n".join(text) + f"\n{END}{after}", encoding="utf-8")


def _whole(found: list[Result]) -> str:
    """What the last run of all of them took, if any of these results is its own."""
    file = KEPT / "whole.json"
    whole = json.loads(file.read_text()) if file.exists() else {}
    if whole.get("commit") not in {one["commit"] for one in found}:
        return ""
    run = f"One run of `make test-platform`, {whole['jobs']} lanes at a time: {whole['took_s'] / 60:.0f} minutes."
    alone = [str(one["lane"]) for one in found if one["commit"] != whole["commit"]]
    return f"\n{run}" + (f" Run again alone since: {', '.join(alone)}." if alone else "")


def _os() -> str:
    return platform.freedesktop_os_release().get("PRETTY_NAME", "?")


def _list() -> int:
    for lane in lanes():
        print(f"{lane.name:24} {lane.shows}")
        if missing := lacking(lane):
            print(f"{'':24} cannot run here: needs {missing}")
    return 0


def main(names: list[str]) -> int:
    """Run, keep, write."""
    possible = names[:1] == ["--possible"]
    names = names[possible:]
    if names == ["--list"]:
        return _list()
    every = [lane.name for lane in lanes()]
    if unknown := set(names) - set(every):
        print(f"no lane {', '.join(sorted(unknown))}; there are: {', '.join(every)}", file=sys.stderr)
        return 2
    KEPT.mkdir(parents=True, exist_ok=True)
    results, skipped, began = [], [], time.monotonic()
    jobs = int(os.environ.get("JOBS") or min(2, os.cpu_count() or 1))
    for result in run_all(names or every, jobs):
        name, said = result["lane"], str(result["result"])
        if possible and said.startswith("not run: "):
            skipped.append(f"lane {name}: skipped: {said.removeprefix('not run: ')}")
            print(f"--- {skipped[-1]}\n", flush=True)
            continue
        results.append(result)
        if not possible:
            (KEPT / f"{name}.json").write_text(json.dumps(result, indent=1), encoding="utf-8")
            write_document()
        print(f"--- lane {name}: {said}, {result['took_s']} s\n", flush=True)
    took_s = time.monotonic() - began
    if not names:
        whole = {"commit": _commit(), "lanes": len(every), "jobs": jobs, "took_s": took_s}
        (KEPT / "whole.json").write_text(json.dumps(whole), encoding="utf-8")
        write_document()
    bad = [result for result in results if result["result"] != "fine"]
    for words in [*skipped, *(f"{result['lane']}: {result['result']}" for result in bad)]:
        print(words)
    print(f"lanes: {took_s:.0f} s")
    if results:
        told = f", {len(skipped)} skipped" if skipped else ""
        print(f"{len(results) - len(bad)} passed, {len(bad)} failed{told}")
    else:
        print("no lane could run here")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
