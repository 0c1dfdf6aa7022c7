"""What the tests of the link and of the journal begin with."""

import pytest
from links import LinkedNode


@pytest.fixture
def path(tmp_path):
    """Where a journal is to be."""
    return tmp_path / "journal.sqlite"


@pytest.fixture
def node(tmp_path):
    nodes = []

    def build(**options):
        nodes.append(LinkedNode(tmp_path, **options))
        return nodes[-1]

    yield build
    for made in nodes:
        made.close()
