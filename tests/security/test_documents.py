"""What the documents for technicians and auditors say is so: tests that they name, causes, exit codes, files."""

import json
import re
from pathlib import Path

from sagnode.asyncapi import CHANNELS
from sagnode.config.mqtt import Mqtt
from sagnode.config.node import Storage
from sagnode.message import QUANTITIES, Reading, reading_estimate
from sagnode.quality import Cause, Validity

ROOT = Path(__file__).parents[2]
SECURITY = (ROOT / "docs" / "security.md").read_text()


def test_every_test_that_the_threat_model_names_exists():
    """``::name`` alone belongs to the file that was named before it."""
    file, named = "", 0
    for path, name in re.findall(r"`((?:tests/[\w/]+\.py)?)(?:::(test_\w+))?`", SECURITY):
        file = path or file
        if path or name:
            text = (ROOT / file).read_text()
            named += 1
            assert not name or f"def {name}(" in text, f"{file}::{name}"
    assert named > 30


OPERATIONS = (ROOT / "docs" / "operations.md").read_text()


def test_every_cause_of_a_reading_is_explained_to_technicians():
    explained = re.findall(r"^\| `([a-z-]+)` \| .+ \| .+ \|$", OPERATIONS, re.MULTILINE)
    assert sorted(set(explained) & {str(cause) for cause in Cause}) == sorted(str(cause) for cause in Cause)


def test_every_line_of_status_is_explained():
    table = OPERATIONS.partition("## Reading `sagnode status`")[2].partition("\n## ")[0]
    explained = set(re.findall(r"`(\w+)`", "\n".join(re.findall(r"^\| (`.+?) \|", table, re.MULTILINE))))
    shown = re.findall(r'yield "(\w+)",', (ROOT / "src" / "sagnode" / "cli" / "status.py").read_text())
    assert len(shown) > 10
    assert explained == set(shown)


def test_every_exit_code_is_explained():
    from sagnode.cli import main
    from sagnode.daemon import node

    known = {value for module in (main, node) for name, value in vars(module).items() if name.startswith("EXIT_")}
    explained = {int(code) for code in re.findall(r"^\| (\d+) \| ", OPERATIONS, re.MULTILINE)}
    assert known == explained


def test_the_count_goes_on_above_a_number_written_by_hand(tmp_path):
    """As "Replacing a card" has it: a new state directory with nothing but that file."""
    from sagnode.daemon.journal import Journal

    (tmp_path / "sequence").write_text("60000\n")
    journal = Journal(tmp_path / "journal.sqlite")
    assert journal.next_sequence == 60001
    journal.close()


MQTT = (ROOT / "docs" / "mqtt.md").read_text()


def test_the_readings_that_are_shown_to_consumers_are_readings():
    good, invalid = (json.loads(text) for text in re.findall(r"^```json\n(.*?)^```$", MQTT, re.MULTILINE | re.DOTALL))
    for shown in (good, invalid):
        assert json.loads(Reading.model_validate(shown).model_dump_json()) == shown
    assert good["quality"]["validity"] == Validity.GOOD
    assert reading_estimate(Reading.model_validate(good), "clearance") is not None
    assert invalid["quality"]["validity"] == Validity.INVALID
    assert {invalid[field] for quantity in QUANTITIES for field in quantity.fields} == {None}


def test_every_topic_is_told_to_consumers_and_what_stays_there():
    table = MQTT.partition("## Topics")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (`.+?) \| (.+?) \|", table, re.MULTILINE)
    retained = {topic: kept != "no" for topics, kept in rows for topic in re.findall("`(.+?)`", topics)}
    topics = {re.sub(r"{(\w+)}", r"<\1>", channel.topic): channel.retain for channel in CHANNELS}
    assert retained == topics


def test_the_settings_that_consumers_rely_on():
    assert "(a day by default)" in MQTT
    assert Mqtt.model_fields["expiry_s"].default == 86400
    for table, model in (("mqtt", Mqtt), ("storage", Storage)):
        named = set(re.findall(rf"`{table}\.(\w+)`", MQTT))
        assert named
        assert named <= model.model_fields.keys()
