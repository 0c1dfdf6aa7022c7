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
        ("schedule", "interval_s", 1e12),
        ("schedule", "deadline_s", 1e9),
        ("schedule", "deadline_s", 1e-9),
        ("camera.replay", "cadence_s", 1e300),
        ("camera.v4l2", "timeout_s", 1e300),
        ("camera.picamera2", "timeout_s", 1e9),
        ("trend", "accept_after_s", 1e300),
        ("alarms", "stale_after_s", 1e12),
        ("worker", "backoff_max_s", 1e12),
        ("recovery", "restart_after_s", 1e12),
        ("recovery", "reboot_wait_h", 1e9),
        ("storage", "keep_mb", 1e300),
        ("storage", "pictures_keep_mb", 1e300),
        ("mqtt", "expiry_s", 10**12),
        ("mqtt", "backlog_per_s", 1e-300),
    ],
)
def test_no_time_is_longer_than_a_clock_can_tell(site: SiteFiles, table: str, key: str, value: Any) -> None:
    assert f"{table}.{key}" in refusal(site, table, key, value)


@pytest.mark.parametrize("value", ["a\0b", "a" * 5000], ids=["null", "long"])
@pytest.mark.parametrize(
    ("table", "key"),
    [("storage", "state_dir"), ("camera.replay", "path"), ("camera.v4l2", "device"), ("mqtt.tls", "ca_file")],
)
def test_a_name_that_no_file_can_have(site: SiteFiles, table: str, key: str, value: str) -> None:
    assert f"{table}.{key}" in refusal(site, table, key, value)


@pytest.mark.parametrize("value", ["a\0b", "a\nb", "a" * 70_000], ids=["null", "two-lines", "long"])
@pytest.mark.parametrize("key", ["client_id", "username", "prefix", "host"])
def test_a_text_that_no_broker_takes(site: SiteFiles, key: str, value: str) -> None:
    assert f"mqtt.{key}" in refusal(site, "mqtt", key, value)


@pytest.mark.parametrize("number", ["9" * 5000, "0x" + "f" * 5000], ids=["decimal", "hexadecimal"])
def test_a_number_of_thousands_of_digits(site: SiteFiles, number: str) -> None:
    site.node.write_text(site.node.read_text().replace("300.0", number))
    with pytest.raises(ConfigError, match="thousands of digits"):
        load_node(site.node)


@pytest.mark.parametrize(
    "change",
    [
        lambda s: s["conductors"][0].update(attachment_u_m=1e300),
        lambda s: s["camera"].update(position_u_m=1e300),
        lambda s: s["ground"].update(profile=[[0.0, 1e300], [100.0, 0.0]]),
        lambda s: s["ground"].update(obstacles=[{"id": "a", "along_m": [1.0, 1e300], "height_m": 0.0}]),
        lambda s: s["landmarks"][0].update(pixel_u_px=1e300),
    ],
)
def test_a_survey_whose_squares_no_number_holds(site: SiteFiles, change: Any) -> None:
    with pytest.raises(ConfigError, match="must be"):
        load_node(site.write(span=change).node)
