"""Plain seeded mutation of real inputs: bytes flip, pieces vanish, repeat or change places, words become nasty."""

import copy
import datetime
import re

_NASTY = (
    b"-1", b"0", b"1e999", b"-1e308", b"nan", b"inf", b"9" * 400, b"0x7fffffff", b"true", b"''", b'""', b"[]", b"{}",
    b"null", b"\x00", b"\xff\xfe", b"\xed\xa0\x80", b"{" * 50, b"[" * 300, b"%s%n", b"../../etc/passwd", b"/dev/zero",
    b"{unit.__class__}", b"{0}", b"\n", b"=", b"#", b'"', b"1979-05-27", b"2026-02-30T25:61:61Z", b"/", b"..",
)  # fmt: skip
_DEEP = b"[" * 2000
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:e-?\d+)?")
_VALUES = (
    None, True, False, 0, -1, 1, 2**31, 2**63, -(2**70), 0.0, -0.0, 1e-320, 1e308, -1e308, float("nan"), float("inf"),
    "", " ", "\x00", "a" * 5000, "ü\u202e", "../..", "/dev/zero", "{0}", "{unit.__class__}", "nan", "1", "true",
    "2026-06-01", [], [[]], [None], [0] * 500, {}, {"": ""}, {"a": {"b": {"c": []}}}, datetime.date(1979, 5, 27),
    datetime.datetime(2026, 6, 1, tzinfo=datetime.UTC), datetime.time(0, 0),
)  # fmt: skip


def mutated(random, data):
    """A copy of some bytes with a few things wrong."""
    data = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 3, 8))):
        at = random.randrange(len(data) + 1)
        length = random.choice((1, 1, 2, 8, 40, 200))
        how = random.randrange(8)
        if how == 0 and data:
            data[at % len(data)] ^= 1 << random.randrange(8)
        elif how == 1:
            del data[at : at + length]
        elif how == 2:
            data[at:at] = data[at : at + length] * random.choice((1, 1, 2, 30))
        elif how == 3:
            data[at:at] = nasty(random)
        elif how == 4:
            data[at : at + length] = random.randbytes(length)
        elif how == 5:
            del data[at:]
        elif numbers := list(_NUMBER.finditer(data)):
            number = random.choice(numbers)
            data[number.start() : number.end()] = nasty(random)
    return bytes(data)


def nasty(random):
    return _DEEP if random.random() < 0.002 else random.choice(_NASTY)


def rearranged(random, document):
    """A copy of a parsed document (tables, lists, values) with a few keys or values wrong."""
    document = copy.deepcopy(document)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        holder, key = random.choice(_places(document))
        how = random.randrange(8)
        if how == 0:
            del holder[key]
        elif how == 1 and isinstance(holder, dict):
            holder[_misspelt(random, key)] = holder.pop(key)
        elif how == 2 and isinstance(holder, list):
            holder.insert(key, copy.deepcopy(random.choice(_places(document))[0]))
        elif how == 3 and isinstance(holder, dict):
            holder[random.choice(("", "x", "__class__", "model_config", "\x00", key * 2))] = copy.deepcopy(
                random.choice(_VALUES)
            )
        elif how == 4 and isinstance(holder[key], int | float):
            holder[key] = holder[key] * random.choice((-1, 0, 1e-9, 1e9, 1.0000001, 10**30))
        elif how == 5:
            holder[key] = [holder[key]]
        else:
            holder[key] = copy.deepcopy(random.choice(_VALUES))
        if not _places(document):
            break
    return document


def _misspelt(random, key):
    at = random.randrange(len(key) + 1)
    return key[:at] + random.choice(("", "_", "x")) + key[at + 1 :]


def _places(document):
    """Every (table or list, key or index) below."""
    found = []
    waiting = [document]
    while waiting:
        holder = waiting.pop()
        pairs = holder.items() if isinstance(holder, dict) else enumerate(holder)
        for key, value in pairs:
            found.append((holder, key))
            if isinstance(value, dict | list):
                waiting.append(value)
    return found
