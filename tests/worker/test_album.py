"""The album on a real disk: what is read is what was written, and whatever else lies there is begun anew."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from nodes import SITE, write_node

from presets import simple_scene
from sagnode.calibrate.files import save_intrinsics
from sagnode.config.load import load_span
from sagnode.geometry.camera import project
from sagnode.match.appearances import Appearance, Appearances, none_kept
from sagnode.pipeline import load_site
from sagnode.scene.render import render
from sagnode.site import Site
from sagnode.worker import album as module
from sagnode.worker.album import Album, read_album, write_album
from sagnode.worker.supervisor import Limits, Supervisor, command_line

FRAMES = sorted((SITE / "frames").glob("*T1[2-3]*.jpg"))
AT = datetime(2026, 6, 21, 12, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return make_site(tmp_path_factory.mktemp("site"))


def make_site(folder: Path, shift: float = 0.0) -> Site:
    scene, still = simple_scene()
    cv2.imwrite(str(folder / "reference.png"), render(scene, still).image)
    save_intrinsics(folder / "camera.yaml", scene.intrinsics)
    camera = scene.surveyed.camera.model_copy(
        update={"intrinsics": folder / "camera.yaml", "reference_image": folder / "reference.png"}
    )
    pixels = project(scene.intrinsics, scene.pose, np.array([m.position for m in scene.true.landmarks]))[0] + shift
    marks = tuple(
        mark.model_copy(update={"pixel": (float(u), float(v))})
        for mark, (u, v) in zip(scene.surveyed.landmarks, pixels, strict=True)
    )
    return load_site(scene.surveyed.model_copy(update={"camera": camera, "landmarks": marks}))


def some(site: Site) -> Appearances:
    rng = np.random.default_rng(1)
    kept = list(none_kept(len(site.landmark_ids)))
    for i, proofs in ((0, 2), (0, 0), (2, 1)):
        image = rng.integers(0, 255, (33, 33)).astype(np.uint8)
        look = Appearance(image, rng.uniform(-0.5, 0.5, 2), AT, AT + timedelta(days=i), proofs)
        kept[i] = (*kept[i], look)
    return tuple(kept)


def same(one: Appearances, other: Appearances) -> bool:
    def plain(kept: Appearances) -> list[object]:
        return [[(a.image.tobytes(), tuple(a.offset), a.cut_at, a.useful_at, a.proofs) for a in own] for own in kept]

    return plain(one) == plain(other)


def test_what_is_written_is_read(site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "appearances"
    assert read_album(path, site) == none_kept(len(site.landmark_ids))
    write_album(path, site, some(site))
    assert same(read_album(path, site), some(site))
    assert [file.name for file in tmp_path.iterdir()] == ["appearances"]
    assert capsys.readouterr().err == ""


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_damaged_file_is_begun_anew(
    site: Site, tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.mktemp("damaged") / "appearances"
    write_album(path, site, some(site))
    whole = path.read_bytes()
    if data.draw(st.booleans()):
        path.write_bytes(whole[: data.draw(st.integers(0, len(whole) - 1))])
    else:
        place = data.draw(st.integers(0, len(whole) - 1))
        path.write_bytes(whole[:place] + bytes([whole[place] ^ data.draw(st.integers(1, 255))]) + whole[place + 1 :])
    assert read_album(path, site) == none_kept(len(site.landmark_ids))


@pytest.mark.parametrize("content", [b"", b"\n", b"\x00" * 5000, b"x" * 4_000_200])
def test_what_is_no_album_is_said(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes
) -> None:
    path = tmp_path / "appearances"
    path.write_bytes(content)
    assert read_album(path, site) == none_kept(len(site.landmark_ids))
    said = capsys.readouterr().err
    assert str(path) in said
    assert "learnt anew" in said


def test_other_clicks_begin_anew(site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "appearances"
    write_album(path, site, some(site))
    (tmp_path / "other").mkdir()
    other = make_site(tmp_path / "other", shift=0.4)
    assert read_album(path, other) == none_kept(len(other.landmark_ids))
    assert "another reference picture" in capsys.readouterr().err


def changed_frame(site: Site, seed: int) -> np.ndarray:
    """The reference's own picture, one landmark in another coat."""
    scene, still = simple_scene()
    image = render(scene, still).image.copy()
    u, v = np.round(site.landmark_clicks[0]).astype(int)
    part = image[v - 14 : v + 15, u - 14 : u + 15]
    coat = np.random.default_rng(1000).integers(0, 256, part.shape).astype(np.uint8)
    part[:] = cv2.addWeighted(part, 0.15, cv2.GaussianBlur(coat, (0, 0), 1.5), 0.85, 0.0)
    return image + np.random.default_rng(seed).integers(0, 2, image.shape).astype(np.uint8)


def test_a_worker_learns_saves_seldom_and_the_next_one_goes_on(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "appearances"
    first = Album(site, path=path)
    first.learn(changed_frame(site, 1), AT)
    assert len(first.kept[0]) == 1
    written = path.read_bytes()
    first.learn(changed_frame(site, 2), AT + timedelta(hours=2))
    assert first.kept[0][0].proven
    assert path.read_bytes() == written  # within the hour
    monkeypatch.setattr(module, "SAVE_EVERY_S", 0.0)
    first.learn(changed_frame(site, 3), AT + timedelta(hours=3))
    assert path.read_bytes() != written
    second = Album(site, path=path)
    assert second.kept[0][0].proven
    message = second.message()
    assert message is not None
    assert (message.appearances, message.on_trial, message.oldest_at) == (1, 0, AT)
    again = path.stat().st_mtime_ns
    second.learn(changed_frame(site, 4), AT + timedelta(hours=4))
    assert path.stat().st_mtime_ns == again  # nothing new


def test_a_disk_that_refuses_costs_the_file_alone(
    site: Site, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    album = Album(site, path=tmp_path / "gone" / "appearances")
    album.learn(changed_frame(site, 1), AT)
    assert len(album.kept[0]) == 1
    assert "in memory only" in capsys.readouterr().err


def test_without_a_file_nothing_is_written(site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    album = Album(site)
    album.learn(changed_frame(site, 1), AT)
    assert list(tmp_path.iterdir()) == []


def test_the_age_of_the_reference_is_told_with_its_source(site: Site, tmp_path: Path) -> None:
    named = tmp_path / "reference-20240203T101500Z.png"
    named.write_bytes(b"")
    plain = tmp_path / "reference.png"
    plain.write_bytes(b"")
    of_name, of_file, of_nothing = (Album(site, f).message() for f in (named, plain, tmp_path / "gone.png"))
    assert of_name is not None
    assert of_file is not None
    assert of_nothing is not None
    assert of_name.reference_taken_at == datetime(2024, 2, 3, 10, 15, tzinfo=UTC)
    assert of_name.reference_taken_from == "name"
    assert of_file.reference_taken_from == "modified"
    assert of_nothing.reference_taken_at is None


@pytest.mark.skipif(not FRAMES, reason="the demonstration's frames are not there")
def test_a_real_worker_leaves_its_album_to_the_next(tmp_path: Path) -> None:
    clicked = load_span(SITE / "span.toml").span.landmarks[3].pixel
    u, v = (round(x) for x in clicked)
    coat = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 256, (61, 61)).astype(np.uint8), (0, 0), 1.0)
    (tmp_path / "frames").mkdir()
    for frame in FRAMES[:2]:
        image = cv2.imread(str(frame), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        image[v - 30 : v + 31, u - 30 : u + 31] = coat
        cv2.imwrite(str(tmp_path / "frames" / frame.with_suffix(".png").name), image)
    node = write_node(tmp_path, 'backend = "replay"\nreplay = { path = "frames" }', "interval_s = 1800", "")
    path = tmp_path / "appearances"
    worker = Supervisor(command_line(node, path), Limits(deadline_s=60.0))
    try:
        first = worker.measure(None).reply
        assert first is not None
        assert first.landmarks is not None
        assert (first.landmarks.appearances, first.landmarks.on_trial) == (0, 0)
        second = worker.measure(None).reply
        assert second is not None
        assert second.landmarks is not None
        assert second.landmarks.on_trial == 1
        assert path.stat().st_size > 33**2
    finally:
        worker.stop()
    assert len(read_album(path, load_site(load_span(SITE / "span.toml").span))[3]) == 1
