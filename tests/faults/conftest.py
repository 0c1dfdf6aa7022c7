import logging
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(autouse=True)
def loud_again():
    """Sections silence sagnode's log for their many damages; the tests after them listen to it."""
    logger = logging.getLogger("sagnode")
    level = logger.level
    yield
    logger.setLevel(level)
