"""Numbers that say themselves whether they are right: each is a function of a token that the reading carries too.

Imports next to nothing, for the stand-in worker starts hundreds of times.
"""

import zlib

FIELDS = tuple(f"{stem}_{part}" for stem in ("sag", "clearance") for part in ("m", "u", "lo", "hi"))


def estimate(token, conductor, stem):
    """Value, standard uncertainty and interval of one quantity, metres."""
    code = zlib.crc32(f"{token} {conductor} {stem}".encode())
    value, u = 5.0 + (code % 1_000_003) / 200_000.0, 0.001 + (code >> 12) / 2.0**24
    return [value, u, value - 2 * u, value + 2 * u]


def is_true(reading):
    """Whether a published reading carries the numbers that were measured, or none and says why."""
    if reading["quality"]["validity"] == "invalid":
        return all(reading[name] is None for name in FIELDS) and bool(reading["quality"]["reasons"])
    token, conductor = reading["landmarks_used"], reading["conductor"]
    expected = estimate(token, conductor, "sag") + estimate(token, conductor, "clearance")
    return [reading[name] for name in FIELDS] == expected
