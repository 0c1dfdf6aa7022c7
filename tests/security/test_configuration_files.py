"""Who else can change what is measured, or read what is secret; and to whom the node speaks without encryption."""

import logging
import os
import shutil
from pathlib import Path

import pytest

import sagnode.cli.status  # before the user is changed to one who may not read the interpreter's own files
from sagnode.check.configuration import check
from sagnode.cli.main import main
from sagnode.config.guard import exposures
from sagnode.config.load import load_node
from sagnode.errors import ConfigError

SITE = Path(__file__).parents[2] / "src" / "sagnode" / "demo" / "site"
MQTT = """
[mqtt]
host = "broker.example.org"
username = "unit"
password_file = "secret"
[mqtt.tls]
ca_file = "ca.crt"
cert_file = "unit.pem"
key_file = "unit.pem"
"""


@pytest.fixture
def site(tmp_path):
    place = tmp_path / "site"
    place.mkdir(mode=0o755)
    for name in ("span.toml", "camera.yaml", "reference.jpg"):
        shutil.copy(SITE / name, place)
    text = (SITE / "node.toml").read_text()
    (place / "node.toml").write_text(text[: text.index("[mqtt]")] + MQTT)
    for name in ("secret", "ca.crt", "unit.pem"):
        (place / name).write_text("x")
        (place / name).chmod(0o640)
    return place


def said(site, **options):
    return [f"{'.'.join(map(str, key))}: {text}" for _, key, text in exposures(load_node(site), **options)]


def test_a_sound_configuration_gives_no_cause(site):
    assert said(site) == []


@pytest.mark.parametrize("name", ["node.toml", "span.toml", "camera.yaml", "reference.jpg", "ca.crt"])
def test_what_everybody_may_write_to_is_told(site, name):
    (site / name).chmod(0o666)
    assert len(said(site)) == 1
    assert f"everybody may write to {site / name}" in said(site)[0]
    warnings = [str(warning) for warning in check(site).warnings]
    assert len([warning for warning in warnings if "everybody may write" in warning]) == 1


def test_a_directory_that_everybody_may_write_to_is_as_bad(site):
    site.chmod(0o777)
    assert any(f"everybody may write to {site}," in text for text in said(site))
    site.chmod(0o1777)  # sticky, as /tmp: nobody can put another file in another's place
    assert said(site) == []


def test_a_strangers_file_is_told(site):
    if os.geteuid() == 0:
        os.chown(site / "span.toml", 54321, -1)
        why = "belongs to user 54321, who may change what is measured"
        assert said(site) == [f": {site}/span.toml {why}; chown root {site}/span.toml"]
    else:
        assert all("belongs to" in text for text in said(site, user=54321))
        assert len(said(site, user=54321)) == 5


@pytest.mark.parametrize(
    ("mode", "fine"), [(0o600, True), (0o640, True), (0o644, False), (0o660, False), (0o602, False)]
)
@pytest.mark.parametrize("name", ["secret", "unit.pem"])
def test_a_secret_is_for_its_owner_and_at_most_a_group(site, name, mode, fine):
    (site / name).chmod(mode)
    assert (said(site) == []) == fine
    assert fine or f"is a secret with mode {mode:04o}" in said(site)[0]


@pytest.mark.parametrize(
    "host", ["broker.example.org", "10.0.0.7", "localhost.evil.org", "2001:db8::1", "127.0.0.1.nip.io"]
)
def test_plain_text_goes_to_the_loopback_alone_unless_said_twice(site, host):
    node = site / "node.toml"
    plain = node.read_text()[: node.read_text().index("[mqtt.tls]")].replace("broker.example.org", host)
    node.write_text(plain)
    with pytest.raises(ConfigError, match=r"in plain text; add a table \[mqtt.tls\]"):
        load_node(site)
    node.write_text(plain + "insecure_plaintext = true\n")
    assert load_node(site).node.mqtt.insecure_plaintext
    assert any("travel in plain text" in str(warning) for warning in check(site).warnings)
    for loopback in ("localhost", "127.0.0.1", "::1"):
        node.write_text(plain.replace(host, loopback))
        load_node(site)


@pytest.mark.parametrize(
    "host", ["mqtts://broker", "broker:8883", "user@broker", "user:word@broker", "a b", "a\\n", "[::1]"]
)
def test_a_host_is_a_host_and_nothing_else(site, host):
    node = site / "node.toml"
    node.write_text(node.read_text().replace("broker.example.org", host))
    with pytest.raises(ConfigError, match="a name or an address alone"):
        load_node(site)


def test_a_closed_state_directory_is_told_with_its_remedy(tmp_path, capsys):
    assert sagnode.cli.status
    state = tmp_path / "state"
    state.mkdir(mode=0)
    if os.geteuid() == 0:
        os.seteuid(65534)
    try:
        assert main(["status", "--state-dir", str(state)]) == 2
    finally:
        if os.getuid() == 0:
            os.seteuid(0)
    error = capsys.readouterr().err
    assert f"{state} is closed to this user" in error and "sudo sagnode status" in error


def test_the_daemon_says_so_at_its_start(site, monkeypatch, caplog):
    """Up to the loop, which is not entered."""
    from sagnode.daemon import logs, node

    (site / "span.toml").chmod(0o666)
    monkeypatch.setattr(node, "run", lambda loaded: 0)
    monkeypatch.setattr(logs, "set_up", lambda level: None)
    before = os.umask(0)
    try:
        with caplog.at_level(logging.WARNING):
            assert main(["run", "--config", str(site)]) == 0
        assert os.umask(0) & 0o027 == 0o027
    finally:
        os.umask(before)
    assert f"everybody may write to {site}/span.toml" in caplog.text
