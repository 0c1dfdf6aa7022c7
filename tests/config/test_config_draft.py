"""A span file may be planned with before anybody has climbed; everything else about it must be in order."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from sagnode.config.draft import load_draft
from sagnode.config.load import load_span
from sagnode.config.show import toml_text
from sagnode.errors import ConfigError

SPAN: dict[str, Any] = {
    "name": "T1-T2",
    "conductors": [
        {
            "id": "L1",
            "near": [0.0, 0.0, 12.0],
            "far": [0.0, 100.0, 12.5],
            "diameter_m": 0.02,
            "sag_min_m": 1.0,
            "sag_max_m": 5.0,
        }
    ],
    "ground": {"profile": [[0.0, 0.0], [100.0, 0.5]]},
}


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    def write_(**tables: Any) -> Path:
        file = tmp_path / "span.toml"
        file.write_text(toml_text({**SPAN, **tables}))
        return file

    return write_


def test_everything_that_needs_a_camera_may_be_missing(write: Callable[..., Path]) -> None:
    file = write(landmarks=[{"id": "peak", "position": [0.0, 100.0, 15.0]}])
    draft = load_draft(file)
    assert (draft.placed, draft.aimed, draft.calibrated) == (False, False, False)
    said = "\n".join(map(str, draft.not_yet))
    for word in (
        "camera.position: the camera has no place yet",
        "camera.azimuth_deg: the camera has no direction yet",
        "camera.elevation_deg",
        "camera.intrinsics: not calibrated yet",
        "camera.reference_image: no reference picture yet",
        "landmarks[0].pixel: not clicked yet",
    ):
        assert word in said
    assert draft.span.name == "T1-T2"
    with pytest.raises(ConfigError):
        load_span(file)


def test_files_that_are_named_and_not_there_are_missing_too(write: Callable[..., Path], tmp_path: Path) -> None:
    camera = {"position": [1.5, 0.5, 4.0], "azimuth_deg": 0.0, "elevation_deg": 3.6}
    named = {**camera, "intrinsics": "camera.yaml", "reference_image": "reference.png"}
    draft = load_draft(write(camera=named))
    assert (draft.placed, draft.aimed, draft.calibrated) == (True, True, False)
    assert draft.span.camera.reference_image is None
    assert [fault.line is not None for fault in draft.not_yet] == [True, True]
    assert f"{tmp_path / 'camera.yaml'} is not there" in str(draft.not_yet[0])
    (tmp_path / "camera.yaml").write_text("x")
    assert load_draft(write(camera=named)).calibrated


def test_a_complete_survey_lacks_nothing_and_a_node_file_leads_to_it(tmp_path: Path) -> None:
    site = Path(load_draft.__code__.co_filename).parents[1] / "demo" / "site"
    for path in (site, site / "node.toml", site / "span.toml"):
        draft = load_draft(path)
        assert draft.not_yet == ()
        assert (draft.placed, draft.aimed, draft.calibrated) == (True, True, True)
        assert draft.span == load_span(site / "span.toml").span


def test_other_faults_are_told_as_ever(write: Callable[..., Path], tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as caught:
        load_draft(write(swing={"max_degrees": 20.0}, landmarks=[{"id": "peak", "position": [0.0, 100.0]}]))
    said = "\n".join(caught.value.faults)
    assert "swing.max_degrees: unknown key; did you mean 'max_deg'?" in said
    assert "landmarks[0].position" in said
    assert "pixel" not in said
    assert str(tmp_path / "span.toml") in said
    with pytest.raises(ConfigError, match="file not found"):
        load_draft(tmp_path / "nothing.toml")
    (tmp_path / "node.toml").write_text('[unit]\nutility = "u"\n')
    with pytest.raises(ConfigError, match="is no span file and names none"):
        load_draft(tmp_path / "node.toml")
