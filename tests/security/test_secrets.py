"""The password and the key are nowhere but in their files and in the daemon's memory."""

import os
import shutil
import signal
import stat
import tarfile
from pathlib import Path

import pytest
from brokers import MOSQUITTO, Mosquitto
from nodes import SITE, start_daemon, status, wait_for, write_node
from utility import CA, enrol, ran

from sagnode.cli.main import main

SECRET = "Tr0ub4dor-and-3"
PASSWD = shutil.which("mosquitto_passwd")

pytestmark = pytest.mark.skipif(
    MOSQUITTO is None or PASSWD is None or shutil.which("openssl") is None,
    reason="mosquitto, mosquitto_passwd or openssl is not installed",
)


@pytest.fixture(scope="module")
def node(tmp_path_factory):
    """A daemon with password and client certificate; refused first, then accepted; every log line kept."""
    tmp_path = tmp_path_factory.mktemp("secrets")
    ca = tmp_path / "ca"
    ran(CA, ca, "init")
    ran(CA, ca, "broker", "localhost")
    site = tmp_path / "site"
    site.mkdir(mode=0o755)
    (site / "frames").mkdir()
    for frame in sorted((SITE / "frames").glob("*T1[2-3]*.jpg"))[:2]:
        shutil.copy(frame, site / "frames")
    enrol(ca, site / "tls", "u/l/s/n")
    (site / "secret").write_text("not yet\n")
    (site / "secret").chmod(0o600)
    users = tmp_path / "users"
    users.write_text("")
    users.chmod(0o600)
    ran(PASSWD, "-b", users, "unit", SECRET)
    keys = ca / "keys"
    tls = f"cafile {ca}/ca.crt\ncertfile {keys}/broker.crt\nkeyfile {keys}/broker.key\nrequire_certificate true"
    lines = [tls, f"password_file {users}"]
    with Mosquitto(tmp_path, *lines, anonymous=False) as broker:
        write_node(
            site,
            'backend = "replay"\nreplay = { path = "frames", at_end = "hold" }',
            "interval_s = 1.0",
            before='log_level = "debug"',
            more=f"""
[mqtt]
host = "localhost"
port = {broker.port}
username = "unit"
password_file = "secret"
[mqtt.tls]
ca_file = "tls/ca.crt"
cert_file = "tls/unit.pem"
key_file = "tls/unit.pem"
""",
        )
        before = os.umask(0o000)  # whoever starts it may be careless
        try:
            process = start_daemon(site, tmp_path / "log")
        finally:
            os.umask(before)
        try:
            wait_for(lambda: "refused: Not authorized" in (tmp_path / "log").read_text())
            (site / "secret").write_text(SECRET + "\n")
            wait_for(lambda: (s := status(site)) and s["broker_connected"] and s["health"]["readings_made"] >= 3)
            yield site, process, tmp_path
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(20)


def hidden(site):
    """What may stand nowhere else: the password, and the longest line of the key."""
    return [SECRET.encode(), (site / "tls" / "unit.pem").read_bytes().splitlines()[1]]


def test_not_in_the_words_or_the_environment_of_any_process(node):
    site, daemon, _ = node
    family = [daemon.pid]
    children = Path(f"/proc/{daemon.pid}/task/{daemon.pid}/children")
    wait_for(lambda: children.read_text().split())  # the worker
    family += [int(pid) for pid in children.read_text().split()]
    for pid in family:
        for source in ("cmdline", "environ"):
            content = Path(f"/proc/{pid}/{source}").read_bytes()
            assert content
            assert not any(secret in content for secret in hidden(site))


def test_not_in_the_log_of_refusals_and_success(node):
    site, _, place = node
    log = (place / "log").read_bytes()
    assert b"connected to broker" in log and b"refused" in log
    assert not any(secret in log for secret in hidden(site))


def test_not_in_anything_that_the_daemon_keeps(node):
    site, _, _ = node
    kept = [file for file in (site / "state").rglob("*") if file.is_file()]
    assert {"journal.sqlite", "status.json"} <= {file.name for file in kept}
    for file in kept:
        assert not any(secret in file.read_bytes() for secret in hidden(site)), file


@pytest.mark.parametrize(
    "words",
    [
        ("config", "show"), ("config", "show", "--json"), ("config", "check"), ("status",), ("status", "--json"),
        ("history",), ("export", "--format", "jsonl"), ("doctor", "--skip", "camera", "--json"),
    ],
    ids=" ".join,
)  # fmt: skip
def test_not_in_what_a_command_prints(node, words, capsys):
    site, _, _ = node
    assert main([*words, "--config", str(site / "node.toml")]) in (0, 1)
    said = "".join(capsys.readouterr()).encode()
    assert said
    assert not any(secret in said for secret in hidden(site))


def test_not_in_a_bundle(node, tmp_path):
    site, _, _ = node
    (site / "node.toml.old").write_text(f'password = "{SECRET}"\n')
    words = ["doctor", "--config", str(site), "--skip", "camera", "--bundle", str(tmp_path / "b.tar.gz")]
    assert main(words) in (0, 1)
    with tarfile.open(tmp_path / "b.tar.gz") as bundle:
        parts = {member.name: bundle.extractfile(member).read() for member in bundle if member.isfile()}
    assert len(parts) > 3
    for name, content in parts.items():
        assert not any(secret in content for secret in hidden(site)), name
    assert stat.S_IMODE((tmp_path / "b.tar.gz").stat().st_mode) == 0o600


def test_what_the_daemon_writes_is_closed_to_others_however_it_was_started(node):
    site, _, _ = node
    made = [site / "state", *(site / "state").rglob("*")]
    assert len(made) > 4
    for path in made:
        mode = stat.S_IMODE(path.stat().st_mode)
        assert mode & 0o027 == 0, f"{path} has mode {mode:04o}"


def test_the_daemon_holds_no_rights_that_it_does_not_need(node):
    """What a unit file takes away it was never given here; this says that nothing asks for it."""
    _, daemon, _ = node
    unit = (Path(__file__).parents[2] / "systemd" / "sagnode.service").read_text().splitlines()
    for line in ("User=sagnode", "CapabilityBoundingSet=", "AmbientCapabilities=", "NoNewPrivileges=yes", "UMask=0027"):
        assert line in unit
    listening = ran("ss", "-Htlnp").stdout if shutil.which("ss") else ""
    assert f"pid={daemon.pid}," not in listening  # it opens no port
