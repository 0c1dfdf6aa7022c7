"""The node that the tests of the link begin with."""

import pytest
from links import LinkedNode


@pytest.fixture
def node(tmp_path):
    nodes = []

    def build(**options):
        nodes.append(LinkedNode(tmp_path, **options))
        return nodes[-1]

    yield build
    for made in nodes:
        made.close()
