"""How long a certificate holds, read from its file without a library for it (RFC 5280, section 4.1)."""

from __future__ import annotations

import re
import ssl
from dataclasses import dataclass
from datetime import UTC, datetime

_PEM = re.compile(r"-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL)
_SEQUENCE, _EXPLICIT_VERSION, _UTC_TIME, _GENERALIZED_TIME = 0x30, 0xA0, 0x17, 0x18
_BEFORE_VALIDITY = 3  # serial number, signature algorithm, issuer


@dataclass(frozen=True)
class Term:
    """From when to when a certificate holds, UTC."""

    begins: datetime
    ends: datetime


def term(pem: str) -> Term:
    """Of the first certificate in a PEM file; keys and further certificates may stand in it too.

    Raises:
        ValueError: there is no certificate in it, or not a whole one.
    """
    found = _PEM.search(pem)
    if found is None:
        raise ValueError("holds no certificate in PEM form")
    data = ssl.PEM_cert_to_DER_cert(found[0])
    try:
        certificate = _value(data, 0, _SEQUENCE)
        body = _value(certificate, 0, _SEQUENCE)
        at = _after(body, 0) if body[0] == _EXPLICIT_VERSION else 0
        for _ in range(_BEFORE_VALIDITY):
            at = _after(body, at)
        validity = _value(body, at, _SEQUENCE)
        return Term(_time(validity, 0), _time(validity, _after(validity, 0)))
    except (IndexError, UnicodeDecodeError) as error:
        raise ValueError("holds a damaged certificate") from error


def _time(data: bytes, at: int) -> datetime:
    kind = data[at]
    text = _value(data, at, kind).decode("ascii")
    if kind == _UTC_TIME:  # two digits of the year: 50 and more are the last century's
        text = ("19" if text[:2] >= "50" else "20") + text
    elif kind != _GENERALIZED_TIME:
        raise ValueError("holds a damaged certificate")
    return datetime.strptime(text, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC)


def _value(data: bytes, at: int, tag: int) -> bytes:
    if data[at] != tag:
        raise ValueError("holds a damaged certificate")
    begin, end = _extent(data, at)
    return data[begin:end]


def _after(data: bytes, at: int) -> int:
    return _extent(data, at)[1]


def _extent(data: bytes, at: int) -> tuple[int, int]:
    """Where the value of the DER element begins and ends."""
    length, begin = data[at + 1], at + 2
    if length & 0x80:
        octets = length & 0x7F
        length, begin = int.from_bytes(data[begin : begin + octets], "big"), begin + octets
    if begin + length > len(data):
        raise IndexError(at)
    return begin, begin + length
