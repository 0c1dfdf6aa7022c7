"""The same call with the compiled kernels left out, for the tests that hold them against NumPy."""

import sys

import pytest


def in_numpy(call, *asked, **words):
    """What a function answers where nothing is compiled: every room that holds the kernels is without them."""
    rooms = [
        room for name, room in list(sys.modules.items()) if name.startswith("sagnode.") and "kernels" in vars(room)
    ]
    assert rooms, "no room holds the kernels under this name"
    with pytest.MonkeyPatch.context() as patch:
        for room in rooms:
            patch.setattr(room, "kernels", None)
        return call(*asked, **words)
