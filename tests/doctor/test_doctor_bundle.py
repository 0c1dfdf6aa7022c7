"""What a bundle holds, and above all what it does not."""

import json
import stat
import tarfile
import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.cli.main import main
from sagnode.doctor.redact import MARK, redact

SECRET = "c0rrect-horse-battery"
KEY = "-----BEGIN EC PRIVATE KEY-----\nMHcCAQEEI" + "A" * 40 + "\n-----END EC PRIVATE KEY-----"


@pytest.mark.parametrize(
    "line",
    [
        f'password = "{SECRET}"',
        f"password='{SECRET}'",
        f"# old: mqtt_password = {SECRET}",
        f'tls = {{ key_password = "{SECRET}", host = "b" }}',
        f'{{"api_key": "{SECRET}"}}',
        f'passphrase = """\n{SECRET}\n"""',
        f"connecting to mqtts://unit:{SECRET}@broker:8883/",
        f"token: {SECRET}",
    ],
)
def test_secrets_go_by_the_name_of_their_key(line):
    assert SECRET not in redact(line)
    assert MARK in redact(line)


def test_what_is_no_secret_stays():
    text = 'password_file = "mqtt-password"\nusername = "unit-1"\nhost = "broker.example"\n'
    assert redact(text) == text
    assert KEY.splitlines()[1] not in redact(f"before\n{KEY}\nafter") and "after" in redact(f"before\n{KEY}\nafter")
    assert KEY.splitlines()[1] not in redact(KEY.rpartition("-----END")[0])  # cut off by a size limit
    assert redact("a b a", ["a"]) == "a b a"


@settings(deadline=None)
@given(st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=4), st.text(), st.text())
def test_a_known_value_is_nowhere(secret, before, after):
    if secret not in MARK:
        assert secret not in redact(f"{before} {secret} {after}", [secret]).replace(MARK, "")


@settings(deadline=None)
@given(st.text(st.characters(min_codepoint=32, max_codepoint=126)))
def test_a_redacted_file_is_still_toml(value):
    text = f"password = {json.dumps(value)}\nhost = 'b'\n"
    assert tomllib.loads(redact(text)) == {"password": MARK, "host": "b"}


def test_a_bundle_holds_what_helps_and_no_secret(node, capsys, tmp_path):
    directory = node('[mqtt]\nhost = "localhost"\nport = 1\nusername = "u"\npassword_file = "mqtt-password"\n')
    (directory / "mqtt-password").write_text(f"{SECRET}\n")
    (directory / "old.toml").write_text(f'password = "{SECRET}-older"\n')
    (directory / "unit.key").write_text(KEY)
    (directory / "notes.txt").write_text(f"the new one is {SECRET}, said the utility")
    (directory / "mqtt-password").chmod(0o644)
    file = tmp_path / "bundle.tar.gz"
    file.write_text("an older one")
    words = ["doctor", "--config", str(directory), "--skip", "system", "--skip", "camera", "--bundle", str(file)]
    assert main(words) == 1  # nothing listens on port 1
    assert "may be read by others" in capsys.readouterr().out
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    with tarfile.open(file) as archive:
        content = {m.name.removeprefix("sagnode-bundle/"): archive.extractfile(m).read() for m in archive.getmembers()}
    for name in ("doctor.json", "configuration/node.toml", "configuration/span.toml", "configuration/camera.yaml"):
        assert name in content
    assert {"configuration/notes.txt", "readings.jsonl", "log.txt", "machine/os-release"} <= set(content)
    assert not any("mqtt-password" in name or name.endswith(".key") for name in content)
    for name, data in content.items():
        assert SECRET.encode() not in data, name
        assert b"PRIVATE KEY-----\nM" not in data, name
    assert json.loads(content["doctor.json"])["verdict"] == "faults"
    assert not list(tmp_path.glob("*.part"))


def test_a_bundle_is_made_of_a_broken_configuration_too(node, tmp_path, capsys):
    directory = node(f'[mqtt]\nhost = "localhost"\npassword = "{SECRET}"\n')
    file = tmp_path / "b.tar.gz"
    assert main(["doctor", "--config", str(directory), "--skip", "system", "--bundle", str(file)]) == 2
    with tarfile.open(file) as archive:
        text = archive.extractfile("sagnode-bundle/configuration/node.toml").read().decode()
    assert MARK in text and SECRET not in text
    assert SECRET not in capsys.readouterr().out
    elsewhere = str(tmp_path / "none" / "b.tar.gz")
    assert main(["doctor", "--config", str(directory), "--skip", "system", "--bundle", elsewhere]) == 1
    assert "cannot be written" in capsys.readouterr().err
