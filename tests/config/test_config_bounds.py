"""Numbers and names beyond what clock, disk and broker can take are refused by the file, not met by the daemon."""

from __future__ import annotations

from typing import Any

import pytest
from config_files import SiteFiles

from sagnode.config.load import load_node
from sagnode.errors import ConfigError


def refusal(site: SiteFiles, table: str, key: str, value: Any) -> str:
    def change(node: dict[str, Any]) -> None:
        here = node
        for part in table.split("."):
            here = here.setdefault(part, {})
        here[key] = value

    with pytest.raises(ConfigError) as caught:
        load_node(site.write(node=change).node)
    (fault,) = caught.value.faults
    return fault


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("storage", "keep_days", 1e6),
    ],
)
def test_no_time_is_longer_than_a_clock_can_tell(site: SiteFiles, table: str, key: str, value: Any) -> None:
    assert f"{table}.{key}" in refusal(site, table, key, value)
