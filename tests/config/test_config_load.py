"""Loading: what is right loads, what is wrong is told all at once, each with its file, line, key and remedy."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from config_files import SiteFiles

from sagnode.config.load import LoadedNode, LoadedSpan, load_any, load_node, load_span
from sagnode.errors import ConfigError


def faults(path: Path) -> list[str]:
    """The faults without the directory, which differs from run to run."""
    with pytest.raises(ConfigError) as caught:
        load_node(path)
    base = path.parent if path.suffix else path
    return [fault.replace(f"{base}/", "") for fault in caught.value.faults]


def test_a_sound_configuration_loads_with_absolute_files(site: SiteFiles) -> None:
    loaded = load_node(site.node)
    assert loaded.path == site.node
    assert loaded.span_path == loaded.node.span_file == site.span
    assert loaded.span.camera.intrinsics == site.directory / "camera.yaml"
    assert loaded.span.camera.reference_image == site.directory / "reference.png"
    assert loaded.node.camera.replay is not None
    assert loaded.node.camera.replay.path == str(site.directory / "frames")


def test_a_directory_means_its_node_file_and_either_kind_of_file_is_known(site: SiteFiles) -> None:
    assert load_node(site.directory) == load_node(site.node)
    assert isinstance(load_any(site.directory), LoadedNode)
    alone = load_any(site.span)
    assert isinstance(alone, LoadedSpan)
    assert alone == load_span(site.span)
    site.node.unlink()
    assert load_any(site.directory) == load_span(site.directory) == alone


def test_relative_names_are_taken_from_the_file_and_not_from_the_working_directory(
    site: SiteFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir("/")
    assert load_node(site.node).span.camera.intrinsics.is_file()
    monkeypatch.chdir(site.directory)
    assert load_node(Path("node.toml")).path == site.node


def test_passwords_come_from_systemds_credentials_if_they_are_there(
    site: SiteFiles, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site.write(node=lambda n: n["mqtt"].update(username="n1", password_file="word"))
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path / "cred"))
    mqtt = load_node(site.node).node.mqtt
    assert mqtt is not None
    assert mqtt.password_file == site.directory / "word"
    (tmp_path / "cred").mkdir()
    (tmp_path / "cred" / "word").write_text("secret")
    mqtt = load_node(site.node).node.mqtt
    assert mqtt is not None
    assert mqtt.password_file == tmp_path / "cred" / "word"


class TestConfigurationId:
    def test_comments_defaults_and_place_do_not_change_it(self, site: SiteFiles, tmp_path: Path) -> None:
        before = load_node(site.node).configuration_id
        site.write(node=lambda n: n["schedule"].update(deadline_s=60.0))
        site.node.write_text("# a comment\n" + site.node.read_text())
        assert load_node(site.node).configuration_id == before
        shutil.copytree(site.directory, tmp_path / "elsewhere")
        assert load_node(tmp_path / "elsewhere").configuration_id == before
        assert len(before) == 12

    @pytest.mark.parametrize("what", ["node", "span", "camera.yaml", "reference.png"])
    def test_every_value_and_named_file_changes_it(self, site: SiteFiles, what: str) -> None:
        before = load_node(site.node).configuration_id
        if what == "node":
            site.write(node=lambda n: n["schedule"].update(interval_s=301))
        elif what == "span":
            site.write(span=lambda s: s["conductors"][0].update(diameter_m=0.021))
        else:
            with (site.directory / what).open("ab") as file:
                file.write(b"\n")
        assert load_node(site.node).configuration_id != before


class TestFaults:
    """Texts are held word by word: they are what a technician reads on a tower."""

    def test_a_misspelt_key_is_told_once_with_the_right_one(self, site: SiteFiles) -> None:
        site.write(span=lambda s: s["conductors"][1].update(sag_mx_m=s["conductors"][1].pop("sag_max_m")))
        assert faults(site.node) == ["span.toml:17: conductors[1].sag_mx_m: unknown key; did you mean 'sag_max_m'?"]

    def test_a_misspelt_table_hides_nothing_in_it(self, site: SiteFiles) -> None:
        def change(node: dict[str, Any]) -> None:
            node["schedul"] = {"interval_s": -5}
            del node["schedule"]

        site.write(node=change)
        assert faults(site.node) == [
            "node.toml:19: schedul: unknown key; did you mean 'schedule'?",
            "node.toml:20: schedule.interval_s: -5: must be 0.1 or more",
        ]

    def test_a_key_that_resembles_none_lists_those_there_are(self, site: SiteFiles) -> None:
        site.write(node=lambda n: n["schedule"].update(colour=1))
        assert faults(site.node) == [
            "node.toml:17: schedule.colour: unknown key; known here: interval_s, cron, deadline_s, clock"
        ]

    def test_all_faults_of_both_files_are_told_at_once(self, site: SiteFiles) -> None:
        def node(n: dict[str, Any]) -> None:
            n["unit"]["utility"] = "has space"
            n["camera"].update(backend="usb", burst=2.5)
            n["mqtt"].update(host="broker.example.org", prefix="a/{b}")

        def span(s: dict[str, Any]) -> None:
            s["conductors"][0]["diameter_m"] = "0.02"
            s["conductors"][1].update(id="L1", far=s["conductors"][1]["near"])
            s["ground"]["profile"] = [[0.0, 0.0], [50.0, 1.0], [40.0, 1.0]]
            del s["camera"]["azimuth_deg"]
            s["camera"]["intrinsics"] = "no.yaml"
            s["landmarks"][1]["id"] = "peak"

        site.write(node, span)
        assert faults(site.node) == [
            (
                "node.toml:4: unit.utility: 'has space': must be 1 to 64 letters, digits, '.', '_' and '-', a letter or"
                " digit first"
            ),
            "node.toml:10: camera.backend: 'usb': must be 'replay', 'v4l2' or 'picamera2'",
            "node.toml:11: camera.burst: 2.5: must be a whole number",
            "node.toml:22: mqtt.prefix: 'a/{b}': unknown field {b}; there are {utility}, {line}, {span}, {unit}",
            "span.toml:7: conductors[0].diameter_m: '0.02': must be a number",
            "span.toml:11: conductors[1]: near and far lie above each other; a span needs horizontal length",
            "span.toml:19: ground: profile: the first number of each pair must ascend",
            (
                "span.toml:22: camera.azimuth_deg: is missing (Direction of the optical axis, clockwise from the site's"
                " north (+y), as a compass shows it)"
            ),
            "span.toml:25: camera.intrinsics: file not found: no.yaml; make it with: sagnode calibrate",
            "span.toml:28: landmarks: id used twice: peak; give each its own",
        ]

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            (
                lambda n: n["mqtt"].update(host="broker.example.org"),
                (
                    "node.toml:18: mqtt: broker.example.org would be spoken to in plain text; add a table [mqtt.tls],"
                    " or say insecure_plaintext = true"
                ),
            ),
            (
                lambda n: n["schedule"].update(cron="* * * * *"),
                "node.toml:15: schedule: give exactly one of interval_s and cron",
            ),
            (
                lambda n: n.update(schedule={"cron": "61 * * * *"}),
                (
                    "node.toml:16: schedule.cron: '61 * * * *': Error validating expression '61': the last value"
                    " (61) is higher than the maximum value (59); must be five fields: minute, hour, day of month,"
                    " month, day of week"
                ),
            ),
            (
                lambda n: n.update(schedule={"cron": "0 0 31 2 *"}),
                (
                    "node.toml:16: schedule.cron: '0 0 31 2 *': there is no such day, and no reading would ever be"
                    " made; check day and month"
                ),
            ),
            (
                lambda n: n["camera"]["replay"].update(start="yesterday", cadence_s=60),
                (
                    "node.toml:14: camera.replay.start: 'yesterday': must be a time in RFC 3339, such as"
                    ' "2026-06-21T04:00:00Z"'
                ),
            ),
            (
                lambda n: n["camera"]["replay"].update(start="2026-06-21T04:00:00", cadence_s=60),
                (
                    "node.toml:14: camera.replay.start: '2026-06-21T04:00:00': must say its zone, such as"
                    ' "2026-06-21T04:00:00Z" for UTC'
                ),
            ),
            (
                lambda n: n.update(camera={"backend": "v4l2"}, schedule={"interval_s": 1, "clock": "virtual"}),
                'node.toml:12: schedule: clock = "virtual" works with camera backend "replay" only, and this is "v4l2"',
            ),
            (
                lambda n: n.update(unit="n1"),
                "node.toml:2: unit: 'n1': must be a table",
            ),
            (
                lambda n: n["unit"].pop("line"),
                "node.toml:3: unit.line: is missing (letters, digits, . _ -)",
            ),
            (
                lambda n: n["schedule"].update(interval_s=True),
                "node.toml:16: schedule.interval_s: true: must be a number",
            ),
            (
                lambda n: n["schedule"].update(interval_s=float("inf")),
                "node.toml:16: schedule.interval_s: inf: must be a finite number",
            ),
        ],
    )
    def test_single_mistakes_of_the_node_file(self, site: SiteFiles, change: Any, text: str) -> None:
        site.write(node=change)
        assert faults(site.node) == [text]

    @pytest.mark.parametrize(
        ("change", "text"),
        [
            (
                lambda s: s["camera"].update(position=[-3.0, 50.0, 12.25]),
                (
                    "span.toml:22: camera: position stands on the chord of conductor L1 (0.000 m off), from where its"
                    " sag cannot be seen; check position, near and far"
                ),
            ),
            (
                lambda s: s["conductors"][0].update(sag_max_m=30.0),
                "span.toml:3: conductors[0]: sag_max_m = 30 exceeds a quarter of the span (100.0 m)",
            ),
            (
                lambda s: [c.update(measured=False) for c in s["conductors"]],
                "span.toml:3: conductors: none has measured = true, so there would be nothing to report",
            ),
            (
                lambda s: s["conductors"][0].update(near=[0.0, float("nan"), 1.0]),
                "span.toml:5: conductors[0].near[1]: nan: must be a finite number",
            ),
            (
                lambda s: s["conductors"][0].update(near=[0.0, 1.0]),
                "span.toml:5: conductors[0].near[2]: is missing",
            ),
            (
                lambda s: s["camera"].update(reference_image="gone.png"),
                "span.toml:27: camera.reference_image: file not found: gone.png; or leave this key out",
            ),
            (
                lambda s: s.update(conductors=[]),
                "span.toml:2: conductors: []: must have at least 1 element(s), and has 0",
            ),
        ],
    )
    def test_single_mistakes_of_the_span_file(self, site: SiteFiles, change: Any, text: str) -> None:
        site.write(span=change)
        assert faults(site.node) == [text]

    def test_toml_syntax_is_told_with_line_and_column(self, site: SiteFiles) -> None:
        site.node.write_text("[unit]\nutility = u\n")
        assert faults(site.node) == [
            (
                "node.toml:2: not TOML: Invalid value at column 11; TOML wants strings in quotes, 'true' and 'false' in"
                " small letters and a dot in decimal numbers"
            )
        ]
        site.write()
        site.span.write_text("a = 1\na = 2\n")
        assert "span_file: span.toml:2: not TOML: Cannot overwrite a value" in faults(site.node)[0]

    def test_files_that_are_none(self, site: SiteFiles, tmp_path: Path) -> None:
        site.write(node=lambda n: n.update(span_file="gone.toml"))
        assert faults(site.node) == ["node.toml:1: span_file: file not found: gone.toml"]
        site.write(node=lambda n: n.update(span_file="frames"))
        assert faults(site.node) == ["node.toml:1: span_file: frames is a directory; name a file"]
        site.node.write_bytes(b"")
        assert faults(site.node) == ["node.toml is empty"]
        site.node.write_bytes('span_file = "Straße"'.encode("latin-1"))
        assert faults(site.node) == ["node.toml:1: not UTF-8 text; save the file in the encoding UTF-8"]
        assert "file not found" in faults(tmp_path / "empty.toml")[0]
        assert "nested too deeply" in faults(_written(site.node, "a = " + "[" * 5000 + "]" * 5000))[0]

    def test_a_span_file_is_not_taken_for_a_node_file(self, site: SiteFiles) -> None:
        with pytest.raises(ConfigError, match="is a span file"):
            load_node(site.span)

    def test_a_byte_order_mark_is_no_fault(self, site: SiteFiles) -> None:
        site.node.write_bytes(b"\xef\xbb\xbf" + site.node.read_bytes())
        assert load_node(site.node).node.unit.unit == "n1"

    def test_one_fault_is_the_errors_own_text_and_several_are_counted(self, site: SiteFiles) -> None:
        site.write(node=lambda n: n["schedule"].update(interval_s=-1))
        with pytest.raises(ConfigError) as caught:
            load_node(site.node)
        assert caught.value.faults == (caught.value.what,)
        assert f"sagnode config check --config {site.node}" in caught.value.remedy
        site.write(node=lambda n: (n["schedule"].update(interval_s=-1), n["unit"].update(unit="")))
        with pytest.raises(ConfigError, match="2 faults in the configuration"):
            load_node(site.node)


def _written(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def test_the_daemon_can_load_without_numpy_and_opencv(site: SiteFiles) -> None:
    code = (
        "import sys; from pathlib import Path; from sagnode.config.load import load_node; load_node(Path(sys.argv[1]));"
        "print([m for m in ('numpy', 'cv2', 'apscheduler', 'paho') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(site.node)], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_a_snapshot_outlives_its_files_and_refuses_another_calibration(site: SiteFiles) -> None:
    loaded = load_node(site.node)
    snapshot = loaded.snapshot()
    site.node.write_text("nonsense")
    assert LoadedNode.from_snapshot(snapshot) == loaded
    loaded.span.camera.intrinsics.write_text("another: calibration\n")
    with pytest.raises(ConfigError, match="was changed after"):
        LoadedNode.from_snapshot(snapshot)
