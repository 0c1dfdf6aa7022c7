"""``sagnode history`` and ``sagnode export`` on a real journal."""

from __future__ import annotations

import csv
import json
import os
import re
import sqlite3
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from sagnode.cli.journal_words import moment
from sagnode.cli.main import main
from sagnode.daemon.journal import Journal
from sagnode.message import Estimate, QualityMessage, Reading, estimate_fields
from sagnode.quality import Cause, Reason, Validity

Capture = pytest.CaptureFixture[str]
START = datetime(2026, 6, 21, 10, 0, tzinfo=UTC)


def reading(conductor: str, at: datetime, *, valid: bool = True) -> object:
    quality = QualityMessage.of(
        Validity.GOOD if valid else Validity.INVALID, () if valid else (Reason(Cause.DARK, "it is night"),)
    )
    values = {"sag": Estimate(8.42, 0.02, 8.38, 8.46), "clearance": Estimate(6.39, 0.05, 6.29, 6.49)}
    values["clearance_along"] = Estimate(134.0, 1.0, 132.0, 136.0)
    return Reading(
        utility="u",
        line="l",
        span="s",
        unit="n",
        conductor=conductor,
        sequence=1,
        acquired_at=at,
        clock_synced=True,
        boot_id="b",
        monotonic_s=1.0,
        quality=quality,
        frames_used=1,
        frames_rejected=0,
        method="rational-bezier",
        calibration_id="c",
        configuration_id="c",
        software_version="0",
        **(estimate_fields(values) if valid else {}),
    )


@pytest.fixture
def state(tmp_path: Path) -> Path:
    """Ten bursts of two conductors a quarter of an hour apart; L2 of the last is invalid; the first is delivered."""
    journal = Journal(tmp_path / "journal.sqlite")
    for k in range(10):
        at = START + timedelta(minutes=15 * k)
        journal.append([reading("L1", at), reading("L2", at, valid=k < 9)], owed=True)
    journal.mark_delivered([1, 2], START + timedelta(hours=3))
    journal.close()
    return tmp_path


def test_history_is_a_table_of_the_newest(state: Path, capsys: Capture) -> None:
    assert main(["history", "--state-dir", str(state), "--last", "2"]) == 0
    header, *rows = [re.split(" {2,}", line) for line in capsys.readouterr().out.splitlines()]
    assert header == [
        "sequence",
        "acquired (UTC)",
        "conductor",
        "sag (95 %)",
        "clearance (95 %)",
        "quality",
        "delivery",
    ]
    time = "2026-06-21 12:15:00"
    assert rows == [
        ["19", time, "L1", "8.420 ± 0.040 m", "6.39 [6.29, 6.49] m at 134 m", "good", "pending"],
        ["20", time, "L2", "-", "-", "invalid (dark)", "pending"],
    ]


def test_signs_that_the_encoding_lacks_become_question_marks(state: Path) -> None:
    words = [sys.executable, "-m", "sagnode", "history", "--state-dir", str(state), "--last", "2"]
    environment = {**os.environ, "PYTHONIOENCODING": "ascii"}
    result = subprocess.run(words, capture_output=True, text=True, timeout=60, env=environment)
    assert (result.returncode, result.stderr) == (0, "")
    assert "8.420 ? 0.040 m" in result.stdout


def test_filters(state: Path, capsys: Capture) -> None:
    words = ["history", "--state-dir", str(state), "--json"]

    def sequences(*more: str) -> list[int]:
        assert main([*words, *more]) == 0
        return [r["sequence"] for r in json.loads(capsys.readouterr().out)["readings"]]

    assert sequences() == list(range(1, 21))
    assert sequences("--conductor", "L2", "--last", "3") == [16, 18, 20]
    assert sequences("--validity", "invalid") == [20]
    assert sequences("--since", "2026-06-21T12:00Z") == [17, 18, 19, 20]
    assert sequences("--since", "2026-06-21T14:00+02:00") == [17, 18, 19, 20]
    assert sequences("--until", "2026-06-21T10:00") == [1, 2]
    assert sequences("--conductor", "L9") == []


def test_export_as_csv_has_a_row_each_and_nothing_where_nothing_is_known(state: Path, capsys: Capture) -> None:
    out = state / "out.csv"
    assert main(["export", "--state-dir", str(state), "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"wrote 20 readings to {out}\n"
    rows = list(csv.DictReader(out.read_text(encoding="utf-8").splitlines()))
    assert [row["sequence"] for row in rows] == [str(n) for n in range(1, 21)]
    assert (rows[0]["sag_m"], rows[0]["clearance_lo"], rows[0]["delivery"]) == ("8.42", "6.29", "delivered")
    assert (rows[19]["sag_m"], rows[19]["validity"], rows[19]["causes"]) == ("", "invalid", "dark")
    assert rows[19]["detail_qual"] == "failure"


def test_a_time_that_no_calendar_has_in_utc_is_a_usage_error(state: Path, capsys: Capture) -> None:
    assert main(["history", "--state-dir", str(state), "--since", "9999-12-31T23:59:59-12:00"]) == 2
    assert "is no time such as" in capsys.readouterr().err


def test_an_export_that_finds_no_room_leaves_no_half_of_it(state: Path) -> None:
    journal = Journal(state / "journal.sqlite")
    journal.append([reading("L1", START + timedelta(days=1, minutes=k)) for k in range(300)], owed=False)
    journal.close()
    out = state / "out.csv"
    words = ["export", "--state-dir", str(state), "--out", str(out)]
    code = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))\n"  # SQLite's index has 32 k
        f"from sagnode.cli.main import main; sys.exit(main({words!r}))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert (result.returncode, result.stdout) == (1, "")
    assert f"cannot write {out}: File too large" in result.stderr
    assert [file.name for file in state.iterdir() if "out" in file.name] == []
    assert main(words) == 0
    assert out.stat().st_size > 40_000


def test_export_as_json_lines_gives_the_published_messages_back(state: Path, capsys: Capture) -> None:
    assert main(["export", "--state-dir", str(state), "--format", "jsonl", "--conductor", "L1"]) == 0
    documents = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(documents) == 10
    assert {documents[0].pop("delivery"), documents[0].pop("delivered_at") is None} == {"delivered", False}
    assert Reading.model_validate(documents[0]).acquired_at == START


def test_a_damaged_reading_is_left_out_and_said(state: Path, capsys: Capture) -> None:
    with sqlite3.connect(state / "journal.sqlite") as db:
        db.execute("UPDATE readings SET json = replace(json, '8.42', '3.42') WHERE sequence = 5")
    assert main(["history", "--state-dir", str(state), "--json"]) == 1
    said = capsys.readouterr()
    assert 5 not in [r["sequence"] for r in json.loads(said.out)["readings"]]
    assert "1 damaged readings were left out" in said.err


def test_the_journal_is_read_while_the_daemon_writes(state: Path, capsys: Capture) -> None:
    journal = Journal(state / "journal.sqlite")
    try:
        journal.append([reading("L1", START + timedelta(hours=9))], owed=False)
        assert main(["history", "--state-dir", str(state), "--last", "1", "--json"]) == 0
        (newest,) = json.loads(capsys.readouterr().out)["readings"]
        assert (newest["sequence"], newest["delivery"]) == (21, "local")
    finally:
        journal.close()


def test_no_journal_and_no_database_are_one_line_each(tmp_path: Path, capsys: Capture) -> None:
    assert main(["history", "--state-dir", str(tmp_path)]) == 1
    assert f"there is no journal at {tmp_path}/journal.sqlite" in capsys.readouterr().err
    (tmp_path / "journal.sqlite").write_bytes(b"no database" * 500)
    assert main(["export", "--state-dir", str(tmp_path)]) == 1
    assert "file is not a database" in capsys.readouterr().err
    assert main(["history", "--state-dir", str(tmp_path / ("x" * 300))]) == 1
    assert "File name too long" in capsys.readouterr().err


def test_the_state_directory_comes_from_the_configuration_or_from_systemd(
    state: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(state))
    assert main(["history", "--last", "1"]) == 0
    configs = Path(__file__).parents[2] / "configs"
    assert main(["history", "--config", str(configs / "lab"), "--last", "1"]) == 0
    assert capsys.readouterr().out.count("invalid (dark)") == 2


@pytest.mark.parametrize("text", ["soon", "2026-13-01", "5y", "-1h", ""])
def test_times_that_are_none(text: str, capsys: Capture) -> None:
    assert main(["history", f"--since={text}"]) == 2
    assert "is no time such as" in capsys.readouterr().err


def test_ages() -> None:
    now = datetime(2026, 6, 21, 12, tzinfo=UTC)
    assert moment("90m", now) == now - timedelta(minutes=90)
    assert moment("2w", now) == now - timedelta(days=14)
