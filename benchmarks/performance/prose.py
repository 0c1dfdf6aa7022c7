"""Sentences of the report."""

from __future__ import annotations


def flow(text: str) -> str:
    """One line out of a text that is broken and indented as the source has it.

    >>> flow('''a
    ...     b''')
    'a b'
    """
    return " ".join(text.split())
