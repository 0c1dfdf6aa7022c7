"""A plausible day: load, sun and wind make temperature, sag and swing; the camera drifts and sways; weather passes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timedelta

import numpy as np

from sagnode.config.span import Conductor, Span
from sagnode.errors import ConfigError
from sagnode.geometry.camera import FloatArray
from sagnode.scene.catenary import WireState
from sagnode.scene.noise import generator
from sagnode.scene.optics import illumination
from sagnode.scene.spec import LensState, Moment, Vector

AIR_DENSITY_KG_M3 = 1.2
DRAG = 1.0
"""Drag coefficient of a stranded conductor."""


@dataclass(frozen=True)
class Spell:
    """A stretch of weather between two hours of the day (UTC); it overrides what the day would bring."""

    hours: tuple[float, float]
    fog_per_m: float = 0.0
    rain: float = 0.0
    cloud: float | None = None
    wind_m_s: float | None = None
    lens: LensState = "clear"
    turn_rad: Vector = (0.0, 0.0, 0.0)
    """An extra turn of the camera: a knock."""


@dataclass(frozen=True)
class DayPlan:
    """What kind of day it is."""

    latitude_deg: float = 51.3
    longitude_deg: float = 12.4
    span_bearing_deg: float = 0.0
    """Compass bearing of the site's +y."""
    air_c: tuple[float, float] = (13.0, 26.0)
    """Lowest (about sunrise) and highest (afternoon) air temperature."""
    load: tuple[float, float] = (0.35, 0.95)
    """Lowest and highest current over the rated current."""
    wind_m_s: float = 4.0
    """Mean wind across the span in the afternoon; the night is calmer."""
    cloud: float = 0.35
    sway_px: float = 1.6
    """Standard deviation of the camera's sway at 5 m/s, expressed at ``focal_px``."""
    drift_px: float = 3.0
    """Amplitude of the slow turn of tower and bracket through the day."""
    focal_px: float = 2050.0
    spells: tuple[Spell, ...] = ()


def sun_position(time: datetime, latitude_deg: float, longitude_deg: float) -> tuple[float, float]:
    """Azimuth (from north, clockwise) and elevation of the sun, degrees, to about half a degree.

    The low-precision formulas of the Astronomical Almanac: mean longitude, equation of centre, obliquity.
    """
    days = (time - datetime(2000, 1, 1, 12, tzinfo=time.tzinfo)).total_seconds() / 86400.0
    anomaly = math.radians((357.528 + 0.9856003 * days) % 360)
    longitude = math.radians(
        (280.460 + 0.9856474 * days + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly)) % 360
    )
    obliquity = math.radians(23.439 - 4e-7 * days)
    ascension = math.atan2(math.cos(obliquity) * math.sin(longitude), math.cos(longitude))
    declination = math.asin(math.sin(obliquity) * math.sin(longitude))
    sidereal = math.radians((280.46062 + 360.98564737 * days + longitude_deg) % 360)
    hour, latitude = sidereal - ascension, math.radians(latitude_deg)
    elevation = math.asin(
        math.sin(latitude) * math.sin(declination) + math.cos(latitude) * math.cos(declination) * math.cos(hour)
    )
    azimuth = math.atan2(
        -math.sin(hour), math.tan(declination) * math.cos(latitude) - math.sin(latitude) * math.cos(hour)
    )
    return math.degrees(azimuth) % 360, math.degrees(elevation)


def sag_at_temperature(conductor: Conductor, temperature_c: float) -> float:
    """Mid-chord sag (m) of a conductor at a temperature, by the state-change equation of a level dead-end span.

    ``H²(H - H₀ + E S α (T - T₀) + E S w² L²/(24 H₀²)) = E S w² L²/24``; the catenary's own sag then follows from H.

    Raises:
        ConfigError: the conductor has no stringing data or no unit weight.
    """
    stringing, weight = conductor.stringing, conductor.unit_weight_n_m
    if stringing is None or weight is None:
        raise ConfigError(
            f"conductor {conductor.id}: a day cannot be simulated without stringing and unit_weight_n_m",
            "add both to the span file",
        )
    span = math.hypot(conductor.far[0] - conductor.near[0], conductor.far[1] - conductor.near[1])
    stiffness = stringing.modulus_gpa * 1e3 * stringing.section_mm2
    load = stiffness * (weight * span) ** 2 / 24
    rest = stringing.tension_n
    slack = stiffness * stringing.expansion_per_k * (temperature_c - stringing.temperature_c) + load / rest**2 - rest
    low, high = 1.0, 100.0 * rest
    for _ in range(100):
        middle = (low + high) / 2
        if middle * middle * (middle + slack) > load:
            high = middle
        else:
            low = middle
    return _sag_of_constant(span, conductor.far[2] - conductor.near[2], low / weight)


def _sag_of_constant(span: float, rise: float, constant: float) -> float:
    """Mid-chord sag of the catenary with a given H/w."""
    vertex = span / 2 - constant * math.asinh(rise / (2 * constant * math.sinh(span / (2 * constant))))
    x = span / 2
    return rise / 2 - 2 * constant * math.sinh((x - 2 * vertex) / (2 * constant)) * math.sinh(x / (2 * constant))


def day_of_moments(span: Span, plan: DayPlan, times: Sequence[datetime], seed: int) -> list[Moment]:
    """The moments of a day.

    Args:
        span: the true span; conductors that are not measured hang as their sag limits' middle says.
        plan: the kind of day.
        times: aware UTC times, ascending.
        seed: everything random about the day follows from it.

    Raises:
        ConfigError: a measured conductor has no stringing data.
    """
    rng = generator(seed, "day")
    gust = _wander(rng, times, minutes=25.0)
    cover = _wander(rng, times, minutes=150.0)
    load_noise = _wander(rng, times, minutes=90.0)
    own = {c.id: (1 + 0.03 * rng.standard_normal(), _wander(rng, times, minutes=15.0)) for c in span.conductors}
    sway = rng.standard_normal((len(times), 3))
    drift_phase = rng.uniform(0, 2 * math.pi, 3)
    moments: list[Moment] = []
    for i, time in enumerate(times):
        hour = time.hour + time.minute / 60 + time.second / 3600
        spell = next((s for s in plan.spells if s.hours[0] <= hour < s.hours[1]), Spell((0.0, 24.0)))
        azimuth, elevation = sun_position(time, plan.latitude_deg, plan.longitude_deg)
        cloud = min(max(plan.cloud + 0.22 * cover[i], 0.0), 1.0) if spell.cloud is None else spell.cloud
        bright = max(math.sin(math.radians(elevation)), 0.0)
        base = plan.wind_m_s * (0.35 + 0.65 * bright) if spell.wind_m_s is None else spell.wind_m_s
        wind = base * (1 + 0.45 * gust[i])
        air = _air_temperature(plan, hour, elevation)
        load = _load(plan, hour) * (1 + 0.06 * load_noise[i])
        heat = (34.0 * load**2 + 13.0 * bright * (1 - 0.75 * cloud)) * 1.6 / math.sqrt(0.6 + abs(wind))
        heat *= 1 - 0.6 * spell.rain
        moments.append(
            Moment(
                wires={
                    c.id: _hang(c, air + heat * own[c.id][0], wind + 0.15 * base * float(own[c.id][1][i]))
                    for c in span.conductors
                },
                time=time,
                turn_rad=_turn(plan, spell, hour, drift_phase, sway[i] * min(abs(wind) / 5.0, 2.5)),
                shift_m=(0.004 * float(sway[i, 1]) * abs(wind) / 5.0, 0.0, 0.001 * float(sway[i, 0])),
                sun_azimuth_deg=(azimuth - plan.span_bearing_deg) % 360,
                sun_elevation_deg=elevation,
                cloud=float(cloud),
                cloud_drift_m=(260.0 * i, 140.0 * i),
                fog_per_m=max(1.4e-4 + 2.5e-4 * math.exp(-(((hour - 3.5) / 2.5) ** 2)), spell.fog_per_m),
                rain=spell.rain,
                lens=spell.lens,
                seed=seed * 1000 + i,
            )
        )
    return [_with_dusk_blur(m) for m in moments]


def _wander(rng: np.random.Generator, times: Sequence[datetime], minutes: float) -> list[float]:
    """A stationary random walk of unit variance with the given correlation time."""
    value = float(rng.standard_normal())
    walk: list[float] = []
    last = times[0] if times else None
    for time in times:
        gap = (time - last) / timedelta(minutes=1) if last else 0.0
        kept = math.exp(-gap / minutes)
        value = kept * value + math.sqrt(1 - kept * kept) * float(rng.standard_normal())
        walk.append(value)
        last = time
    return walk


def _air_temperature(plan: DayPlan, hour_utc: float, elevation: float) -> float:
    """Coolest near sunrise, warmest some three hours after the sun's highest."""
    solar = (hour_utc + plan.longitude_deg / 15.0) % 24
    phase = math.cos((solar - 15.0) / 24 * 2 * math.pi)
    low, high = plan.air_c
    return low + (high - low) * (0.5 + 0.5 * phase) - (0.5 if elevation < 0 else 0.0)


def _load(plan: DayPlan, hour_utc: float) -> float:
    """Two peaks, morning and evening, over a nightly valley."""
    low, high = plan.load
    local = (hour_utc + 2.0) % 24
    shape = 0.85 * math.exp(-(((local - 11.0) / 3.6) ** 2)) + math.exp(-(((local - 19.0) / 3.0) ** 2))
    return low + (high - low) * min(shape, 1.0)


def _hang(conductor: Conductor, temperature_c: float, wind_m_s: float) -> WireState:
    """Sag and swing of one wire; that wind also stretches it (some centimetres of sag in a gale) is left out."""
    weight = conductor.unit_weight_n_m or 400.0 * conductor.diameter_m
    drag = 0.5 * AIR_DENSITY_KG_M3 * DRAG * conductor.diameter_m * wind_m_s * abs(wind_m_s)
    swing = math.degrees(math.atan2(drag, weight))
    if conductor.measured:
        return WireState(sag_at_temperature(conductor, temperature_c), swing)
    middle = (conductor.sag_min_m + conductor.sag_max_m) / 2
    return WireState(middle * (1 + 0.0015 * (temperature_c - 30.0)), swing)


def _turn(plan: DayPlan, spell: Spell, hour: float, phase: FloatArray, sway: FloatArray) -> Vector:
    """Rotation vector: slow drift with the sun, sway with the wind, and a knock."""
    daily = np.sin(2 * math.pi * hour / 24 + phase) * plan.drift_px
    pixels = daily * np.array([1.0, 0.8, 0.4]) + sway * plan.sway_px * np.array([1.0, 1.0, 0.5])
    x, y, z = pixels / plan.focal_px + np.array(spell.turn_rad)
    return float(x), float(y), float(z)


def _with_dusk_blur(moment: Moment) -> Moment:
    """Long exposures in twilight smear the picture a little."""
    darkness = -math.log10(max(illumination(moment), 1e-9))
    return replace(moment, psf_px=0.75 + 0.12 * min(max(darkness - 3.0, 0.0), 3.0))
