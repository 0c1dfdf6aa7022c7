"""``sagnode replay``: the daemon's readings of stored frames, beside the truth and beside earlier ones."""

from __future__ import annotations

import contextlib
import json
import shutil
from pathlib import Path

import pytest

from sagnode.cli.main import main
from sagnode.daemon.journal import Journal
from sagnode.message import Reading, ReadingHeader
from sagnode.quality import Cause

Capture = pytest.CaptureFixture[str]


def replay(lab: Path, capsys: Capture, *words: str | Path) -> tuple[int, str, str]:
    capsys.readouterr()
    code = main(["replay", "--config", str(lab), *map(str, words)])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.fixture(scope="module")
def written(lab: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The laboratory's three frames, replayed into a file."""
    file = tmp_path_factory.mktemp("replay") / "readings.jsonl"
    assert main(["replay", "--config", str(lab), str(lab / "frames"), "--out", str(file)]) == 0
    return file


def readings_in(file: Path) -> list[ReadingHeader]:
    return [Reading.model_validate_json(line) for line in file.read_text().splitlines()]


def test_readings_are_those_of_the_daemon_in_the_order_of_the_frames(lab: Path, written: Path, capsys: Capture) -> None:
    readings = readings_in(written)
    assert [reading.sequence for reading in readings] == [1, 2, 3, 4, 5, 6]
    assert [reading.conductor for reading in readings] == ["right", "left"] * 3
    times = [reading.acquired_at for reading in readings[::2]]
    assert times == sorted(set(times))
    capsys.readouterr()
    frames = sorted((lab / "frames").glob("*.png"))
    assert main(["measure", "--config", str(lab), "--json", *map(str, frames)]) == 0
    measured = json.loads(capsys.readouterr().out)["readings"]
    for reading, other in zip(readings, measured, strict=True):
        document = reading.model_dump(mode="json")
        for field in ("sag_m", "sag_u", "clearance_lo", "configuration_id", "calibration_id"):
            assert document[field] == other[field]
    # two centimetres of a model's sag in ten minutes are more heat than the watch believes in
    assert {other["quality"]["validity"] for other in measured} == {"good"}
    # (of one wire or of both: it is not far beyond what their uncertainties leave open)
    assert {r.cause for reading in readings[-2:] for r in reading.quality.reasons} == {Cause.THERMAL_TREND}


def test_truth_beside_the_frames_is_compared_with(lab: Path, capsys: Capture) -> None:
    code, out, err = replay(lab, capsys, lab / "frames")
    assert (code, err) == (0, "")
    assert "6 readings of 3 frames:" in out
    assert "0 invalid" in out
    assert "95 % interval holds the truth 6 of 6 times" in out
    assert out.count("  right     sag 0.") == 3


def test_standard_output_can_be_the_readings_alone(lab: Path, capsys: Capture) -> None:
    code, out, err = replay(lab, capsys, lab / "frames", "--out", "-", "--burst", "2")
    assert code == 0
    readings = [Reading.model_validate_json(line) for line in out.splitlines()]
    assert [reading.frames_used for reading in readings] == [2, 2, 1, 1]
    assert "4 readings of 2 frames" in err


def test_the_same_readings_do_not_differ_and_others_do(
    lab: Path, written: Path, tmp_path: Path, capsys: Capture
) -> None:
    code, out, _ = replay(lab, capsys, lab / "frames", "--against", written)
    assert code == 0
    assert "6 of 6 readings have an earlier one beside them; 0 differ" in out
    documents = [json.loads(line) for line in written.read_text().splitlines()]
    documents[1]["sag_m"] += 0.02
    documents[2]["quality"]["validity"] = "invalid"
    changed = tmp_path / "changed.jsonl"
    changed.write_text("\n".join(map(json.dumps, documents[:5])))
    code, out, _ = replay(lab, capsys, lab / "frames", "--against", changed)
    assert code == 1
    assert "5 of 6 readings have an earlier one beside them; 2 differ" in out
    assert "left: sag 0." in out
    assert "right: invalid became " in out
    assert "at most -20.0 mm" in out


def test_a_journal_can_be_compared_with(lab: Path, written: Path, tmp_path: Path, capsys: Capture) -> None:
    with contextlib.closing(Journal(tmp_path / "journal.sqlite")) as journal:
        journal.append(readings_in(written), owed=False)
    for path in (tmp_path, tmp_path / "journal.sqlite"):
        code, out, _ = replay(lab, capsys, lab / "frames", "--against", path)
        assert code == 0
        assert "6 of 6 readings have an earlier one beside them; 0 differ" in out


def test_a_damaged_frame_is_an_invalid_reading_and_the_next_one_goes_on(
    lab: Path, tmp_path: Path, capsys: Capture
) -> None:
    frames = tmp_path / "frames"
    shutil.copytree(lab / "frames", frames)
    first = sorted(frames.glob("*.png"))[0]
    first.write_bytes(first.read_bytes()[:300])
    code, out, err = replay(lab, capsys, frames)
    assert code == 1
    assert "6 readings of 3 frames:" in out
    assert "2 invalid" in out
    assert "invalid (bad-frame)" in out
    assert first.name in err


def test_a_span_file_alone_is_enough(lab: Path, capsys: Capture) -> None:
    code, out, _ = replay(lab / "span.toml", capsys, lab / "empty", "--out", "-")
    assert code == 0
    readings = [Reading.model_validate_json(line) for line in out.splitlines()]
    assert [(r.utility, r.span, r.quality.validity) for r in readings] == [("replay", "model-1-100", "invalid")] * 2


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (("nowhere",), "no such file or directory"),
        (("frames", "--against", "nowhere"), "cannot read"),
        (("frames", "--against", "span.toml"), "no reading as a JSON object"),
        (("frames", "--burst", "0"), "out of range"),
        (("frames", "--cadence", "-1"), "out of range"),
        (("frames", "--out", "nowhere/readings.jsonl"), "cannot write"),
    ],
)
def test_errors_say_what_to_do(
    words: tuple[str, ...], what: str, lab: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(lab)
    code, _, err = replay(lab, capsys, *words)
    assert code in {1, 2}
    assert what in err
    assert "remedy:" in err
