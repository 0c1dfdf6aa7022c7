"""The dates in a certificate, against openssl's own reading of them."""

import subprocess
from datetime import UTC, datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sagnode.daemon.certificate import term


@pytest.fixture(scope="module")
def pem(tmp_path_factory):
    directory = tmp_path_factory.mktemp("certificate")

    def make(days, kind="ec"):
        more = ["-pkeyopt", "ec_paramgen_curve:P-256"] if kind == "ec" else []
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", kind, *more, "-nodes", "-days", str(days), "-subj", "/CN=a,O=b",
             "-keyout", "k.pem", "-out", "c.pem"],
            cwd=directory, check=True, capture_output=True,
        )  # fmt: skip
        text = (directory / "c.pem").read_text()
        said = subprocess.run(
            ["openssl", "x509", "-in", "c.pem", "-noout", "-dates"],
            cwd=directory,
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        dates = dict(line.split("=") for line in said.splitlines())
        expected = [
            datetime.strptime(dates[k], "%b %d %H:%M:%S %Y GMT").replace(tzinfo=UTC) for k in ("notBefore", "notAfter")
        ]
        return (directory / "k.pem").read_text() + text, expected

    return make


@pytest.mark.parametrize(("days", "kind"), [(1, "ec"), (730, "rsa:2048"), (20000, "ec")])
def test_the_dates_are_those_that_openssl_reads(pem, days, kind):
    """Before 2050 as UTCTime, later as GeneralizedTime; a key may stand in front."""
    text, (begins, ends) = pem(days, kind)
    assert (term(text).begins, term(text).ends) == (begins, ends)


@pytest.mark.parametrize("text", ["", "nonsense", "-----BEGIN CERTIFICATE-----\nMAA=\n-----END CERTIFICATE-----"])
def test_what_is_no_certificate_is_told(text):
    with pytest.raises(ValueError, match=r"holds (no|a damaged) certificate"):
        term(text)


@given(st.data())
@settings(max_examples=300, deadline=None)
def test_a_damaged_certificate_is_an_error_of_one_kind(data):
    text = (
        "-----BEGIN CERTIFICATE-----\n"
        "MIIBfjCCASWgAwIBAgIUQ0QeBCCaz1qWm1UaL8Wfmg0bxp0wCgYIKoZIzj0EAwIw\n"
        "-----END CERTIFICATE-----"
    )
    body = bytearray(text.encode())
    for _ in range(data.draw(st.integers(0, 8))):
        body[data.draw(st.integers(28, len(body) - 26))] = data.draw(st.sampled_from(b"ABCDEFGHabcdefgh0123456789+/="))
    with pytest.raises(ValueError):
        term(body.decode())
