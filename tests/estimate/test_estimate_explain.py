"""Refused frames name what was before the lens; frames that can be measured are not refused for it."""

from importlib.resources import files
from pathlib import Path

import cv2
import numpy as np
import pytest

from sagnode.config.load import load_span
from sagnode.pipeline import load_site, measure_frame
from sagnode.quality import Cause, DetailQual, Validity

SITE = Path(str(files("sagnode.demo") / "site"))


@pytest.fixture(scope="module")
def site():
    return load_site(load_span(SITE / "span.toml").span)


@pytest.fixture(scope="module")
def noon():
    return cv2.imread(str(next((SITE / "frames").glob("*T120000Z.jpg"))), cv2.IMREAD_GRAYSCALE)


def test_fog_is_named_beside_what_it_did(site, noon):
    foggy = np.round(180 + 0.04 * (noon.astype(float) - 180)).astype(np.uint8)
    for measured in measure_frame(site, foggy):
        assert measured.validity is Validity.INVALID
        assert not measured.estimates
        assert measured.reasons[0].cause is not Cause.FOG
        assert measured.reasons[-1].cause is Cause.FOG
        assert measured.reasons[-1].detail_qual is DetailQual.FAILURE


def test_a_night_that_is_refused_as_dark_says_so_once(site, noon):
    for measured in measure_frame(site, np.zeros_like(noon)):
        assert [reason.cause for reason in measured.reasons] == [Cause.DARK]


def test_a_few_drops_are_no_reason_to_refuse_what_can_be_measured(site, noon):
    wet = noon.copy()
    for left in (150, 950, 1150):  # beside the wires and landmarks
        part = wet[930:1060, left : left + 130]
        part[:] = cv2.GaussianBlur(part, (0, 0), 15)
    dry, through = measure_frame(site, noon), measure_frame(site, wet)
    assert [m.validity for m in through] == [m.validity for m in dry]
    assert [m.reasons for m in through] == [m.reasons for m in dry]
