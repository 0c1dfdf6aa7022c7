"""Takes secrets out of text that leaves the machine: by the names of keys, by form, and by their known values."""

from __future__ import annotations

import re
from collections.abc import Iterable

MARK = "(redacted)"
_WORD = r"pass(?:word|wd|phrase)|secret|token|credentials?|api_?key|private_?key|psk"
_VALUE = r'"""(?s:.*?)"""' + r"|'''(?s:.*?)'''" + r'|"(?:\\.|[^"\\\n])*"' + r"|'[^'\n]*'" + r"|[^\s,;}\]#]+"
# The word ends the key: password = ..., "mqtt_password": ..., but not password_file = ...
_NAMED = re.compile(rf"(?i)([\w.-]*(?:{_WORD})[\"']?\s*[=:]\s*)({_VALUE})")
_IN_URL = re.compile(r"(?i)(\b[a-z][a-z0-9+.-]*://[^\s/:@]*:)([^\s/@]+)(@)")
_PEM = re.compile(r"-----BEGIN [A-Z0-9 ]*PRIVATE KEY-----(?s:.*?)(?:-----END [A-Z0-9 ]*PRIVATE KEY-----|\Z)")
_SHORTEST = 4


def redact(text: str, known: Iterable[str] = ()) -> str:
    """The text with every secret replaced by :data:`MARK`.

    Args:
        text: of a configuration, a log, a status page; comments count too, for old passwords live there.
        known: values that are secret wherever they stand; those under four characters would tear up the text
            and are left to the other rules.
    """
    text = _PEM.sub(MARK, text)
    text = _IN_URL.sub(rf"\1{MARK}\3", text)
    text = _NAMED.sub(lambda found: found[1] + _quoted(found[2]), text)
    for value in sorted({value for value in known if len(value) >= _SHORTEST}, key=len, reverse=True):
        text = text.replace(value, MARK)
    return text


def _quoted(value: str) -> str:
    """As the value was written, so that a TOML or JSON file stays one."""
    quote = value[0] if value[0] in "\"'" else ""
    return f"{quote}{MARK}{quote}"
