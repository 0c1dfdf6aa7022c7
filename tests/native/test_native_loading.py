"""The compiled module where it is not what is wanted: the program goes on without it, and says why."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sagnode
from sagnode.native import kernels

HERE = Path(sagnode.__file__).parent


def loaded(place, **environment):
    """What a process says that finds the package's room of kernels at a place."""
    words = [sys.executable, "-c", "from sagnode.native import kernels, why_not; print(kernels is None, why_not)"]
    environment = {**os.environ, "SAGNODE_NATIVE": "1", "PYTHONPATH": str(place), **environment}
    said = subprocess.run(words, capture_output=True, text=True, env=environment, timeout=60, check=False)
    assert said.returncode == 0, said.stderr
    return said.stdout.strip()


@pytest.fixture
def place(tmp_path):
    """A package of that room alone, with nothing compiled in it."""
    room = tmp_path / "sagnode" / "native"
    room.mkdir(parents=True)
    shutil.copy(HERE / "__init__.py", room.parent)
    shutil.copy(HERE / "native" / "__init__.py", room)
    return tmp_path


def test_one_that_was_not_built(place):
    assert loaded(place) == "True they were not built when sagnode was installed"


def test_one_that_is_left_out(place):
    assert loaded(place, SAGNODE_NATIVE="0") == "True left out, as SAGNODE_NATIVE=0 says"


def test_one_that_is_no_module_of_this_machine(place):
    (place / "sagnode/native/_kernels.abi3.so").write_bytes(b"\x7fELF of another processor")
    assert loaded(place).startswith("True they cannot be loaded: ")


@pytest.mark.skipif(kernels is None, reason="the extension was not built here")
def test_one_of_another_versions_sources(place):
    room = place / "sagnode" / "native"
    shutil.copy(kernels.__file__, room)
    assert loaded(place) == "False"
    text = (room / "__init__.py").read_text()
    # of another length: bytecode of the same second and size would be taken for that of this text
    (room / "__init__.py").write_text(text.replace(f"\nINTERFACE = {kernels.INTERFACE}\n", "\nINTERFACE = -1000\n"))
    assert loaded(place) == "True they were built from the sources of another version"
