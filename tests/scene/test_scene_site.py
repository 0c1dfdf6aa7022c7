"""The demonstration's site: what is kept in the package is what the generator makes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from sagnode.config.load import load_node
from sagnode.geometry.camera import inside, project
from sagnode.scene.__main__ import main
from sagnode.scene.render import render
from sagnode.scene.site import JPEG_QUALITY, REFERENCE_QUALITY, clicked, demo_site, site_directory
from sagnode.scene.spec import survey_pose
from sagnode.scene.truth import read_truth, truth_document
from sagnode.scene.writer import encoded, frame_name

SITE = site_directory()


def decoded(data: bytes) -> NDArray[np.uint8]:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    return np.asarray(picture, np.uint8)


def assert_same_picture(kept: Path, image: NDArray[np.uint8], quality: int) -> None:
    """The same up to what another processor's last digit of an exponential does: single grey levels, before JPEG."""
    ours = decoded(encoded(image, "jpg", quality)).astype(int)
    theirs = decoded(kept.read_bytes()).astype(int)
    assert ours.shape == theirs.shape
    difference = np.abs(ours - theirs)
    assert difference.mean() < 0.02
    assert (difference > 3).mean() < 1e-4


@pytest.mark.parametrize("index", [20, 29])
def test_two_frames_of_the_day_are_rendered_again(index: int) -> None:
    site = demo_site()
    moment = site.day[index]
    kept = SITE / "frames" / f"{frame_name(moment.time)}.jpg"
    rendered = render(site.scene, moment)
    assert_same_picture(kept, rendered.image, JPEG_QUALITY)
    truth = read_truth(kept)
    for name, values in rendered.truth["conductors"].items():  # type: ignore[attr-defined]
        for key, value in truth.document["conductors"][name].items():
            if key not in ("pixels", "contrast_grey", "visible_share", "resolved_share"):
                assert values[key] == pytest.approx(value, abs=2e-4), (name, key)


def test_the_reference_picture_is_rendered_again() -> None:
    site = demo_site()
    assert_same_picture(SITE / "reference.jpg", render(site.scene, site.reference).image, REFERENCE_QUALITY)


def test_every_moment_of_the_day_is_kept_with_its_truth() -> None:
    site = demo_site()
    assert len(site.day) == 48
    for moment in site.day:
        kept = SITE / "frames" / f"{frame_name(moment.time)}.jpg"
        assert kept.is_file()
        truth = read_truth(kept)
        assert truth.time == moment.time
        assert set(truth.conductors) == {"L1", "L2", "L3", "earth"}
        assert truth.document["camera"] == truth_document(site.scene, moment, {})["camera"]


def test_the_day_has_readable_and_unreadable_frames() -> None:
    shares = [
        [c["resolved_share"] for name, c in read_truth(f).document["conductors"].items() if name != "earth"]
        for f in sorted((SITE / "frames").glob("*.json"))
    ]
    assert sum(min(s) > 0.6 for s in shares) >= 28
    assert sum(max(s) < 0.1 for s in shares) >= 6


def test_the_landmarks_were_clicked_in_the_reference_picture() -> None:
    site = demo_site()
    clicks = clicked(site.scene)
    pixels, _ = project(
        site.scene.intrinsics, site.scene.pose, np.array([m.position for m in site.scene.true.landmarks])
    )
    assert len(clicks) >= 8
    for mark, pixel in zip(site.scene.surveyed.landmarks, pixels, strict=True):
        assert mark.pixel == pytest.approx(clicks[mark.id], abs=0.051)
        assert np.abs(np.array(mark.pixel) - pixel).max() < 4 * mark.pixel_u_px + 0.05
    spread = np.ptp([m.pixel for m in site.scene.surveyed.landmarks], axis=0)
    assert spread[0] > 900
    assert spread[1] > 450


def test_the_survey_is_an_honest_one() -> None:
    """The true world differs from the survey, and by no more than its uncertainties allow."""
    site = demo_site()
    errors = [
        (np.array(t.position) - np.array(s.position)) / s.position_u_m
        for t, s in zip(site.scene.true.landmarks, site.scene.surveyed.landmarks, strict=True)
    ]
    errors += [
        (np.array(getattr(t, end)) - np.array(getattr(s, end))) / s.attachment_u_m
        for t, s in zip(site.scene.true.conductors, site.scene.surveyed.conductors, strict=True)
        for end in ("near", "far")
    ]
    scaled = np.concatenate(errors)
    assert 0.7 < np.sqrt(np.mean(scaled**2)) < 1.3
    assert np.abs(scaled).max() < 4


def test_conductors_do_not_overlap_in_the_view() -> None:
    site = demo_site()
    span, pose = site.scene.surveyed, survey_pose(site.scene.surveyed)
    moment = site.day[20]
    curves = []
    for conductor in span.conductors:
        from sagnode.scene.catenary import wire_points

        points = wire_points(
            np.array(conductor.near), np.array(conductor.far), moment.wires[conductor.id], np.linspace(0, 0.95, 3000)
        )
        pixels, _ = project(site.scene.intrinsics, pose, points)
        curves.append(pixels[inside(site.scene.intrinsics, pixels)][::6])
    for i, one in enumerate(curves):
        for other in curves[i + 1 :]:
            gaps = np.hypot(one[:, None, 0] - other[None, :, 0], one[:, None, 1] - other[None, :, 1])
            assert gaps.min() > 4


def test_the_site_is_a_configuration_that_can_be_used_and_is_small() -> None:
    node = load_node(SITE / "node.toml")
    assert node.node.schedule.clock == "virtual"
    assert node.node.mqtt is None
    assert sum(f.stat().st_size for f in SITE.rglob("*") if f.is_file()) <= 7.5e6


def test_the_command_prints_the_clicks_and_names_its_faults(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--out", str(tmp_path), "--clicks"]) == 0
    clicks = capsys.readouterr().out
    for landmark in load_node(SITE / "node.toml").span.landmarks:
        assert f"{landmark.id}: pixel = {list(landmark.pixel)}" in clicks
    assert main(["demo", "--out", str(tmp_path), "--site", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "span.toml" in error
    assert "Traceback" not in error


def test_a_configured_span_is_rendered_from_the_shell(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sagnode", "scene", "--config", str(SITE / "span.toml")]
    done = subprocess.run([*command, "--out", str(tmp_path / "new")], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    (picture,) = (tmp_path / "new").glob("*.jpg")
    assert read_truth(picture).conductors.keys() == {"L1", "L2", "L3", "earth"}
