"""The fixture that every configuration test begins with."""

from __future__ import annotations

from pathlib import Path

import pytest
from config_files import SiteFiles


@pytest.fixture
def site(tmp_path: Path) -> SiteFiles:
    """A sound configuration in a directory of its own."""
    return SiteFiles(tmp_path / "site")
