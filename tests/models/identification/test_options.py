"""Options that cannot work are refused in one line, before any work."""

from dataclasses import replace
from typing import Any

import pytest

from seatrial.models.errors import ConfigurationError

# Of an identifier and a vessel: options, and what is said of them.
REFUSED: dict[tuple[str, str], list[tuple[dict[str, Any], str]]] = {
    ("ls", "milliampere"): [
        ({"lowpass_hz": -1.0}, "lowpass_hz must be positive or null, got -1"),
        ({"basis": "all"}, "basis: got 'all', expected full, physical, linear or a list of terms"),
        ({"basis": ["u", "uu", "u^2"]}, "is given twice"),
        ({"extra_terms": ["speed"]}, "expected factors"),
        ({"force": "thrust"}, "force: got 'thrust'"),
        ({"force": "filtered", "thruster": "none"}, "needs a thruster lag"),
        ({"force": "actual", "thruster": "estimated"}, "force must be filtered or null"),
        ({"force": "filtered"}, "has no known thruster lag"),
        ({"extra_terms": ["w"]}, "term w has w, but milliampere moves in"),
    ],
    ("iv", "milliampere"): [
        ({"iterations": -1}, "iterations must not be negative, got -1"),
        ({"restart_s": 0.0}, "restart_s must be positive or null, got 0"),
        ({"wind_terms": ["|u|u"]}, "wind_terms: got |u|u, expected terms in V_q, u_q, v_q"),
        ({"instruments": "measured"}, "instruments"),
        ({"wind_measurement": True}, "the recorded file has no wind"),
        ({"extra_terms": ["|u_q|u_q"]}, "needs wind_measurement=true"),
    ],
    ("iv", "surge_linear"): [
        ({"wind_measurement": True}, "wind_measurement needs a vessel in surge, sway"),
    ],
    ("plsr", "milliampere"): [
        ({"block_s": 0.0}, "block_s must be positive, got 0"),
        ({"selection": "peek"}, "selection: got 'peek'"),
    ],
    ("plsr", "surge_linear"): [
        ({"force": "filtered"}, "force=filtered: surge_linear has no known thruster lag"),
    ],
    ("surface_plsr", "milliampere"): [
        ({"stages": 0}, "stages must be at least 1, got 0"),
        ({"selection": "best"}, "selection: got 'best', expected one of minimum, "),
        ({"validation": "peek"}, "validation: got 'peek'"),
    ],
    ("robust", "milliampere"): [
        ({"tune": {"pryor": [1.0]}}, "tune.pryor: unknown option, did you mean prior?"),
        ({"tune": {"tune": [{}]}}, "tune.tune: unknown option, expected one of basis"),
        ({"tune": {"prior": [1.0, -1.0]}}, "tune.prior[1] must be positive, got -1"),
        ({"input_terms": True}, "has no devices"),
    ],
    ("robust", "beluga_linear"): [
        ({"disturbance": "windage"}, "disturbance=windage needs a vessel in surge"),
        ({"disturbance": "both"}, "disturbance=both needs a vessel in surge"),
    ],
    ("dsr", "milliampere"): [
        ({"L": 1}, "L must be at least 2, got 1"),
        ({"extra_terms": ["1"]}, "expected a term that varies"),
        ({"extra_terms": ["u_dot"]}, "are in the model already"),
        ({"extra_terms": ["u"]}, "are in the model already"),
        ({"inputs": []}, "inputs: got [], expected different names"),
        ({"outputs": ["u", "u"]}, "outputs: got ['u', 'u'], expected different names"),
        ({"order": 8}, "got 8, but milliampere has 6 states"),
        ({"order": 8, "L": 2, "physical_form": "optional"}, "expected at most L x outputs = 6"),
        ({"inputs": ["tau_roll"]}, "inputs: got tau_roll, expected tau_surge, tau_sway, tau_yaw"),
        ({"inputs": ["1"]}, "inputs: got 1, expected tau_surge, tau_sway, tau_yaw"),
        ({"outputs": ["z"]}, "term 'z': got 'z'"),
        ({"outputs": ["p"]}, "outputs: got p, expected x, y, psi or terms that"),
    ],
    ("dsr", "kvlcc2"): [({}, "identifier=dsr needs forces")],
    ("nsga2", "surge_linear"): [
        ({"population": 2}, "population must be at least 4"),
        ({"weights": [1.0, 0.0]}, "weights[1] must be positive"),
        ({"weights": [1.0]}, "expected 2"),
        ({"inertia_factor": None}, "bounds.surge.u_dot: got none"),
        ({"inertia_factor": None, "parameters": ["surge.u^2"]}, "bounds.surge.u^2: got none"),
    ],
    ("output_error", "surge_linear"): [
        ({"bounds": {"surge.u": [3.0, 1.0]}}, "a lower and a higher number"),
        ({"bounds": {"surge.v": [1.0, 3.0]}}, "not a parameter"),
        ({"inertia_factor": 1.0}, "inertia_factor must be above 1"),
        ({"parameters": ["yaw.r"]}, "one of the degrees of freedom surge"),
        ({"parameters": ["surge.u", "surge.u"]}, "given twice"),
        ({"parameters": ["surge.vv_dotx"]}, "expected factors"),
        ({"parameters": []}, "no coefficient"),
        ({"force": "measured"}, "force: got 'measured'"),
    ],
    ("output_error", "kvlcc2"): [
        ({"outputs": {"w": 1.0, "u": 1.0}},
         "outputs: got w, expected some of x, y, psi, u, v, r, propeller.th"),
        ({"outputs": {"u": 0.0}}, "outputs.u must be positive, got 0"),
        ({"outputs": {"propeller.thrust": 1.0}}, "outputs: got no state"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(("name", "sailed"), REFUSED)
def test_what_cannot_work_is_refused(
    identifier, vessel, name: str, sailed: str, subtests: pytest.Subtests
) -> None:
    nominal = vessel(sailed)
    for options, message in REFUSED[name, sailed]:
        with subtests.test(**options):
            with pytest.raises(ConfigurationError) as caught:
                identifier(name, **options).check(nominal, None, measured=True)
            assert message in str(caught.value)
            assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "options", "sailed"),
    [
        ("dsr", {}, "milliampere"),
        ("dsr", {"inputs": ["tau_yaw", "uv"], "outputs": ["psi", "r_dot"]}, "milliampere"),
        ("robust", {}, "beluga_linear"),
        ("robust", {"disturbance": "ned_force"}, "beluga_linear"),
        ("nsga2", {"parameters": ["surge.u^2"]}, "surge_linear"),  # needs no other bounds
    ],
)
def test_what_can_work_is_not_refused(identifier, vessel, name: str, options, sailed: str) -> None:
    identifier(name, **options).check(vessel(sailed), None, measured=True)


def test_a_nominal_inertia_must_be_positive_definite(identifier, milliampere) -> None:
    heavy = replace(milliampere, theta=-milliampere.theta)
    with pytest.raises(ConfigurationError, match="inertia matrix must be positive definite"):
        identifier("iv", inertia_factor=None).check(heavy, None, measured=False)
