"""Noise of a recorded manoeuvre decides no verdict: its measures come with intervals that hold."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.excitation.helm import SteeredMission
from seatrial.models.notation import OrderedManoeuvre
from seatrial.models.simulation.manoeuvre_sheet import (
    MEASURED,
    Sheet,
    Track,
    measured_sheet,
    sheet,
    track_of,
)
from seatrial.models.weather.disturbance import Disturbance
from seatrial.runner.trials.manoeuvre_results import sailed
from tests.trials import composed

DEVIATION = {"north": 0.1, "east": 0.1, "psi": np.radians(0.1), "speed": 0.02}
HERTZ = {10: 1, 1: 10}  # every which sample of a track of 10 Hz
MANOEUVRES = ("rudder_zigzag", "rudder_turn", "rudder_pull_out", "spiral", "williamson")
ROUNDING = 1e-5  # of a value: the smoothing of a track without noise


def calm_track(vessel: str, excitation: str) -> tuple[Track, OrderedManoeuvre]:
    """The motion of the nominal model without noise, at 10 Hz, and which manoeuvre it is."""
    parts = ("evaluation=none", "controller=none", "identifier=none", "sample_time_s=0.1")
    trial = composed(f"vessel={vessel}", f"excitation={excitation}", "disturbance=calm", *parts)
    trial, mission = replace(trial, disturbance=Disturbance()), trial.excitation
    assert isinstance(mission, SteeredMission)
    recording = sailed(trial, mission, trial.vessel.nominal())
    kind = getattr(mission, "manoeuvre", None)
    assert kind in MEASURED
    track = track_of(recording, mission.helm, trial.vessel.scales.length_m)
    return track, OrderedManoeuvre(kind)


def recorded(track: Track, hertz: int, seed: int | None) -> Track:
    """A track as it would be recorded: sampled at a rate, with white noise unless seed is None."""
    part = track.part(slice(None, None, HERTZ[hertz]))
    if seed is None:
        return part
    rng, noisy = np.random.default_rng(seed), dict[str, Any]()
    for name, deviation in DEVIATION.items():
        noisy[name] = getattr(part, name) + deviation * rng.standard_normal(len(part.t))
    return replace(part, **noisy)


def held(track: Track, ordered: OrderedManoeuvre, hertz: int, seed: int | None) -> list[bool]:
    """Whether the interval of each measure holds the value of the track without noise."""
    return holds(measured_sheet(recorded(track, hertz, seed), ordered), sheet(track, ordered))


def holds(found: Sheet, truth: Sheet) -> list[bool]:
    """Whether each interval holds the true value."""
    result = []
    for entry in found.entries:
        true = truth.values.get(entry.quantity, np.nan)
        if np.isfinite(true):
            rounding = ROUNDING * abs(true)
            result.append(entry.low - rounding <= true <= entry.high + rounding)
    return result


@pytest.mark.parametrize("excitation", ["rudder_zigzag", "rudder_turn"])
def test_intervals_hold_the_value_without_noise(excitation: str) -> None:
    track, ordered = calm_track("kvlcc2_full", excitation)
    cases = [(1, None), (10, None), (1, 0), (1, 1), (1, 2)]
    inside = [one for hertz, seed in cases for one in held(track, ordered, hertz, seed)]
    assert np.mean(inside) >= 0.85


def test_intervals_hold_where_the_heading_is_rounded() -> None:
    """To a tenth of a degree: at its extremes a slow turn stays at one reading for 10 s."""
    track, ordered = calm_track("kvlcc2_full", "rudder_zigzag")
    truth, step, inside = sheet(track, ordered), np.radians(0.1), list[bool]()
    for origin in np.linspace(0.0, step, 8)[1:]:
        psi = origin + step * np.round((track.psi - origin) / step)
        inside += holds(measured_sheet(replace(track, psi=psi), ordered), truth)
    assert np.mean(inside) >= 0.85


@pytest.mark.nightly
def test_intervals_hold_on_three_ships_in_every_manoeuvre() -> None:
    inside = []
    for vessel in ("kvlcc2_full", "mariner", "tanker"):
        for excitation in MANOEUVRES:
            try:
                track, ordered = calm_track(vessel, excitation)
                sheet(track, ordered)
            except (ConfigurationError, RecordingError):  # no manoeuvre of this vessel
                continue
            for hertz in HERTZ:
                for seed in (None, *range(10)):
                    inside += held(track, ordered, hertz, seed)
    assert len(inside) > 1000
    assert np.mean(inside) >= 0.85


def test_noise_does_not_decide_a_verdict() -> None:
    """A zig-zag of 10/10 whose initial turning is within its limit, by far."""
    track, ordered = calm_track("kvlcc2_full", "rudder_zigzag")
    noisy = recorded(track, 1, 0)
    initial = {e.quantity: e for e in measured_sheet(noisy, ordered).entries}["initial turning"]
    assert initial.verdict == "pass"
    near = initial._replace(limit=initial.value)
    assert near.verdict == "not settled"


def test_a_mirrored_recording_has_mirrored_measures() -> None:
    track, ordered = calm_track("kvlcc2_full", "rudder_zigzag")
    noisy = recorded(track, 1, 0)
    mirrored = replace(noisy, east=-noisy.east, psi=-noisy.psi, helm=-noisy.helm)
    there, here = measured_sheet(noisy, ordered), measured_sheet(mirrored, ordered)
    for one, other in zip(there.entries, here.entries, strict=True):
        sign = -1.0 if one.quantity == "helm" else 1.0
        assert other.value == pytest.approx(sign * one.value, rel=1e-9)


@pytest.mark.parametrize("hertz", HERTZ)
def test_a_zigzag_of_ten_to_both_sides_is_one_at_any_rate(hertz: int) -> None:
    track, ordered = calm_track("kvlcc2_full", "rudder_zigzag")
    found = measured_sheet(recorded(track, hertz, 0), ordered)
    assert (round(abs(found.values["helm"])), found.ordered.turn_deg) == (10, 10.0)
    assert any(entry.limit is not None for entry in found.entries)
