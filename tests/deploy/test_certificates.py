"""deploy/certificates: the way of a key and its certificate, and every way of getting it wrong."""

import os
import re
import shutil
import stat
import subprocess
import sys

import pytest
from utility import CA, ENROL, ROOT, enrol, ran

pytestmark = pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed")

UNIT = "grid/110kv-7/t12-t13/unit-1"


@pytest.fixture
def ca(tmp_path):
    ran(CA, tmp_path / "the ca", "init", "Grid authority")
    return tmp_path / "the ca"


def listed(ca, *days, fails=False):
    return ran(CA, ca, "list", *days, fails=fails).stdout


def mode(path):
    return stat.filemode(path.stat().st_mode)[1:]


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="shellcheck is not installed")
@pytest.mark.parametrize("script", [CA, ENROL], ids=lambda path: path.name)
def test_the_scripts_are_clean(script):
    assert ran("shellcheck", script).stdout == ""


def test_the_key_is_made_on_the_unit_and_stays_there(ca, tmp_path):
    pem = enrol(ca, tmp_path / "tls", UNIT)
    text = pem.read_text()
    assert "PRIVATE KEY" in text and "BEGIN CERTIFICATE" in text
    key = text[: text.index("-----BEGIN CERT")]
    assert not [f for f in ca.rglob("*") if f.is_file() and key[60:120] in f.read_text()]
    assert mode(pem) == mode(tmp_path / "tls" / "ca.crt") == "rw-r-----"
    assert mode(tmp_path / "tls") == "rwxr-x---"
    assert not (tmp_path / "tls" / "pending.key").exists()
    assert {mode(f) for f in ca.rglob("*.key")} == {"rw-------"}


def test_python_accepts_what_is_made_by_the_strictest_rules(ca, tmp_path):
    """RFC 5280 as Python 3.13 asks for it, on the whole chain."""
    pem = enrol(ca, tmp_path / "tls", UNIT)
    ran(CA, ca, "broker", "broker.example.org", "192.0.2.7", "fe80::1")
    for purpose, crt in (("sslclient", pem), ("sslserver", ca / "keys" / "broker.crt")):
        ran("openssl", "verify", "-x509_strict", "-purpose", purpose, "-CAfile", ca / "ca.crt", crt)
    ran("openssl", "verify", "-purpose", "sslserver", "-CAfile", ca / "ca.crt", pem, fails=True)
    named = ran("openssl", "x509", "-in", ca / "keys" / "broker.crt", "-noout", "-ext", "subjectAltName").stdout
    assert "DNS:broker.example.org, IP Address:192.0.2.7, IP Address:FE80" in named


def test_the_authority_decides_on_the_name(ca, tmp_path):
    """What the request says of itself counts for nothing: neither its name, nor the extensions it asks for."""
    csr = tmp_path / "greedy.csr"
    ran("openssl", "req", "-new", "-newkey", "rsa:2048", "-nodes", "-keyout", tmp_path / "k", "-out", csr,
        "-subj", "/CN=operator", "-addext", "basicConstraints=critical,CA:TRUE",
        "-addext", "subjectAltName=DNS:broker.example.org")  # fmt: skip
    crt = ran(CA, ca, "sign", UNIT, csr).stdout.strip()
    text = ran("openssl", "x509", "-in", crt, "-noout", "-text").stdout
    assert re.search(f"Subject: CN ?= ?{re.escape(UNIT)}\n", text)  # OpenSSL 3.0 writes spaces, 3.5 none
    assert "CA:FALSE" in text and "CA:TRUE" not in text
    assert "broker.example.org" not in text


@pytest.mark.parametrize(
    "name", ["a/b", "a/b/c/d/e", "/a/b/c", "a/b/c/", "a//b/c", "a b", "a/+/c/d", "#", "", "x" * 65, "a/b/c/" + "d" * 60]
)
def test_names_that_no_topic_and_no_acl_can_bear_are_refused(ca, tmp_path, name):
    csr = tmp_path / "r.csr"
    csr.write_text(ran(ENROL, "--tls", tmp_path / "t", "--name", "ok", "request").stdout)
    assert "sagnode-ca: error: '" in ran(CA, ca, "sign", name, csr, fails=True).stderr


@pytest.mark.parametrize(("kind", "said"), [("rsa:1024", "RSA key of 1024 bits"), ("ec", "key of 192 bits")])
def test_weak_keys_are_not_signed(ca, tmp_path, kind, said):
    more = ["-pkeyopt", "ec_paramgen_curve:prime192v1"] if kind == "ec" else []
    csr = tmp_path / "weak.csr"
    ran(
        "openssl",
        "req",
        "-new",
        "-newkey",
        kind,
        *more,
        "-nodes",
        "-keyout",
        tmp_path / "k",
        "-subj",
        "/CN=x",
        "-out",
        csr,
    )
    assert said in ran(CA, ca, "sign", UNIT, csr, fails=True).stderr


def test_what_does_not_belong_together_is_not_installed(ca, tmp_path):
    pem = enrol(ca, tmp_path / "tls", UNIT)
    before = pem.read_bytes()
    csr, options = tmp_path / "r.csr", ("--tls", tmp_path / "tls", "--name", UNIT)
    csr.write_text(ran(ENROL, *options, "request").stdout)
    assert pem.read_bytes() == before  # the old pair stays in force meanwhile
    crt = ran(CA, ca, "sign", UNIT, csr).stdout.strip()
    ran(CA, tmp_path / "other", "init")

    def refused(certificate, authority, *words):
        said = ran(ENROL, *(words or options), "install", certificate, authority, fails=True).stderr
        assert pem.read_bytes() == before
        return said

    assert "is not accepted" in refused(crt, tmp_path / "other" / "ca.crt")
    assert "is no certificate" in refused(csr, ca / "ca.crt")
    assert f"is for {UNIT} and this is a/b/c/d" in refused(crt, ca / "ca.crt", *options[:2], "--name", "a/b/c/d")
    old = ran(CA, ca, "sign", UNIT, csr, UNTIL="20200101000000Z").stdout.strip()
    assert "expired" in refused(old, ca / "ca.crt")
    csr.write_text(ran(ENROL, *options, "request").stdout)  # a new key: the signature is for the one before
    assert "belongs to another key" in refused(crt, ca / "ca.crt")


def test_renewal_and_its_reminder(ca, tmp_path):
    enrol(ca, tmp_path / "tls", UNIT, DAYS="10")
    assert "RENEW" in listed(ca, "30", fails=True)
    ran(ENROL, "--tls", tmp_path / "tls", "show", "9")
    assert "within 30 days" in ran(ENROL, "--tls", tmp_path / "tls", "show", "30", fails=True).stderr
    enrol(ca, tmp_path / "tls", UNIT)
    assert "RENEW" not in listed(ca, "30")
    assert listed(ca).count("in force") == 2
    ran(ENROL, "--tls", tmp_path / "tls", "show", "30")


def test_revocation_is_of_a_name_or_of_one_certificate(ca, tmp_path):
    for _ in range(3):
        enrol(ca, tmp_path / "tls", UNIT)
    first = listed(ca).splitlines()[0].split()[3]
    ran(CA, ca, "revoke", UNIT, first)
    assert (listed(ca).count("revoked"), listed(ca).count("in force")) == (1, 2)
    ran(CA, ca, "revoke", UNIT)
    crl = ran("openssl", "crl", "-in", ca / "crl.pem", "-noout", "-text").stdout
    assert crl.count("Serial Number:") == 3
    assert "no certificate of" in ran(CA, ca, "revoke", UNIT, fails=True).stderr
    ran(CA, ca, "crl")


def test_an_authority_is_not_written_over_and_may_be_locked(ca, tmp_path):
    assert "holds an authority already" in ran(CA, ca, "init", fails=True).stderr
    words = tmp_path / "passphrase"
    words.write_text("correct horse\n")
    ran(CA, tmp_path / "locked", "init", PASSPHRASE_FILE=str(words))
    assert "ENCRYPTED" in (tmp_path / "locked" / "ca.key").read_text()
    pem = enrol(tmp_path / "locked", tmp_path / "tls", UNIT, PASSPHRASE_FILE=str(words))
    assert pem.exists()
    words.write_text("wrong\n")
    assert ran(CA, tmp_path / "locked", "consumer", "scada", PASSPHRASE_FILE=str(words), fails=True)
    # The authority may be moved: nothing in it knows where it stood.
    ca.rename(tmp_path / "moved")
    ran(CA, tmp_path / "moved", "consumer", "scada")


def test_a_unit_asks_by_the_name_in_its_node_file(tmp_path):
    shutil.copytree(ROOT / "src/sagnode/demo/site", tmp_path / "site")
    node = (tmp_path / "site" / "node.toml").read_text()
    command = tmp_path / "bin" / "sagnode"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec {sys.executable} -m sagnode "$@"\n')
    command.chmod(0o755)
    path = f"{command.parent}:{os.environ['PATH']}"
    csr = ran(ENROL, "--config", tmp_path / "site" / "node.toml", "request", PATH=path).stdout
    subject = subprocess.run(["openssl", "req", "-noout", "-subject"], input=csr, capture_output=True, text=True).stdout
    unit = dict(
        line.replace('"', "").split(" = ") for line in node.splitlines() if line.startswith(("utility", "line", "unit"))
    )
    assert f"{unit['utility']}/{unit['line']}/" in subject and subject.strip().endswith(unit["unit"])
    assert (tmp_path / "site" / "tls" / "pending.key").exists()


def test_a_unit_may_ask_before_its_survey_and_calibration_are_there(tmp_path):
    unit = '[unit]\nutility = "grid"\nline = "l"\nspan = "1-2"\nunit = "n1"\n'
    (tmp_path / "node.toml").write_text(f'span_file = "nowhere.toml"\n{unit}')
    csr = ran(ENROL, "--config", tmp_path, "request").stdout
    subject = subprocess.run(["openssl", "req", "-noout", "-subject"], input=csr, capture_output=True, text=True).stdout
    assert "grid/l/1-2/n1" in subject
    (tmp_path / "node.toml").write_text(unit.replace("unit = ", "name = "))
    assert "does not say the unit's name" in ran(ENROL, "--config", tmp_path, "request", fails=True).stderr


@pytest.mark.parametrize("words", [(), ("wat",), ("install", "one"), ("--wat",)])
def test_wrong_words_are_answered_with_the_usage(tmp_path, words):
    for command in ([ENROL, *words], [CA, tmp_path, *words] if words[:1] != ("--wat",) else [CA]):
        result = subprocess.run([str(w) for w in command], capture_output=True, text=True)
        assert result.returncode in (1, 2) and ("request" in result.stderr or "no authority" in result.stderr), result


def test_the_package_brings_the_script_ready_to_run(tmp_path):
    """The parts of deploy/build_deb.py that need no network."""
    code = (
        "import sys; sys.path.insert(0, 'deploy'); import build_deb, pathlib, targets\n"
        f"tree = pathlib.Path({str(tmp_path)!r}) / 'tree'; tree.mkdir()\n"
        "build_deb._add_files(tree, next(iter(targets.SUITES.values())), '0'); build_deb._settle(tree)"
    )
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True)
    installed = tmp_path / "tree" / "usr" / "sbin" / "sagnode-enrol"
    assert installed.read_bytes() == ENROL.read_bytes()
    assert mode(installed) == "rwxr-xr-x"
    assert "Recommends: openssl" in (ROOT / "deploy/debian/control").read_text()
