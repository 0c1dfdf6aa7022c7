"""The compiled way works with the constants of the NumPy way, whose modules say what they are for."""

import re
from importlib import import_module
from pathlib import Path

import pytest

from sagnode import native

SOURCES = Path(native.__file__).parent
DEFINED = re.compile(r"^#define (\w+) (-?[\d.]+(?:e-?\d+)?)f?$", re.MULTILINE)
SAME = {
    "across.h": ["across"],
    "closer.c": ["closer", "surer"],
    "localise.c": ["across"],
    "peaks.c": ["across"],
    "places.c": ["bundle", "family", "ribbon"],
    "sight.c": ["sight"],
    "standing.c": ["standing"],
    "wire.h": ["kernels", "surer"],
}
"""Modules of sagnode.match whose constants of the same names a source has."""
OWN = {
    "closer.c": {"GAIN_LEAST", "GAIN_MOST", "NOTHING"},
    "localise.c": {"MOST_STEPS", "MOST_WIRES"},
    "places.c": {"LEAST_SQUARE"},
}
"""What a source has under names of its own."""


def defined(name):
    return dict(DEFINED.findall((SOURCES / name).read_text(encoding="utf-8")))


@pytest.mark.parametrize("name", SAME)
def test_constants_are_those_of_numpy(name):
    modules = [import_module(f"sagnode.match.{module}") for module in SAME[name]]
    shared = defined(name).keys() - OWN.get(name, set())
    assert shared
    for constant in shared:
        expected = [getattr(module, constant) for module in modules if hasattr(module, constant)]
        assert expected, f"{name}: {constant} is in none of {SAME[name]}"
        assert {float(value) for value in expected} == {float(defined(name)[constant])}, f"{name}: {constant}"


def test_no_two_sources_define_the_same():
    everything = [constant for source in SOURCES.glob("*.[ch]") for constant in defined(source.name)]
    assert sorted(everything) == sorted(set(everything))
