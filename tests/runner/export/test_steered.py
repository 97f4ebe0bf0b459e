"""Models of steered vessels leave with their devices and inputs, as vessels and as equations."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from omegaconf import OmegaConf

from docs.vessels import parameters_of, vessels
from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.pose import Quaternion
from seatrial.models.vessel.thruster import step_lag_kernel
from seatrial.runner.configuration import options
from seatrial.runner.export.equations import Equations
from seatrial.runner.export.model_formats import FORMATS, write
from seatrial.runner.export.stored_model import StoredModel
from tests.runner.export.compiled import CURRENT, WIND, Ours, Theirs, compiled, octave, relative
from tests.trials import CONF

STEERED = tuple(name for name in vessels() if parameters_of(name).inputs)
DIFFERENT = ("kvlcc2", "milliampere_azimuths", "remus100")  # in their devices and kinematics
SOME_AND_THE_OTHERS = pytest.mark.parametrize("names", [
    DIFFERENT,
    pytest.param(tuple(n for n in STEERED if n not in DIFFERENT), marks=pytest.mark.nightly),
])  # fmt: skip
STEPS, STEP_S, EQUAL = 10_000, 0.1, 1e-9


def stored(name: str) -> StoredModel:
    """An identified model of a run with the vessel: its coefficients times 0.9."""
    vessel = OmegaConf.to_container(OmegaConf.load(CONF / "vessel" / f"{name}.yaml"))
    groups = dict.fromkeys(("disturbance", "excitation", "identifier"), "none")
    summary = SimpleNamespace(run_id=7, vessel=name, seed=0, **groups)
    run: Any = SimpleNamespace(summary=summary, config={"vessel": vessel})
    return StoredModel(run, "identified", parameters_of(name).nominal() * 0.9)


def numbers(vessel: VesselParameters) -> dict[str, Any]:
    """Everything by which a simulation knows the vessel."""
    plant = vessel.nominal().plant_table()
    known = {"devices": vessel.devices, "inputs": vessel.inputs, "dofs": vessel.dofs}
    return known | {"entries": plant.entries, "inverse": plant.inverse_inertia}


def test_it_comes_back_to_the_last_digit(tmp_path: Path, subtests: pytest.Subtests) -> None:
    assert len(STEERED) == 18
    for name in STEERED:
        if "\ndefaults:" in (CONF / "vessel" / f"{name}.yaml").read_text():
            continue  # not in one file
        with subtests.test(name):
            model = stored(name)
            for form in ("yaml", "json"):
                (file,) = write(model, form, tmp_path / f"{name}.{form}")
                check_equal(file, model)


def check_equal(file: Path, model: StoredModel) -> None:
    """A file holds a model to the last digit."""
    again = options.part(VesselParameters, OmegaConf.to_container(OmegaConf.load(file)))
    assert isinstance(again, VesselParameters)
    for key, value in numbers(again).items():
        np.testing.assert_array_equal(value, numbers(model.parameters)[key], err_msg=key)
    table, own = again.nominal(), model.table
    found, wanted = (dict(zip(map(str, t.terms), t.theta, strict=True)) for t in (table, own))
    for term, row in wanted.items():
        np.testing.assert_array_equal(found.get(term, 0.0 * row), row)


def test_a_format_without_inputs_says_so(tmp_path: Path) -> None:
    model = stored("mariner")
    inputs = ", ".join(model.parameters.inputs)
    for to in (name for name, form in FORMATS.items() if not form.inputs):
        expected = f"--to {to}: got mariner_7, which is commanded by {inputs}, expected a vessel by"
        with pytest.raises(ConfigurationError, match=expected) as error:
            write(model, to, tmp_path / f"again{FORMATS[to].endings[0]}")
        assert "\n" not in str(error.value)
    assert list(tmp_path.iterdir()) == []


def equations_of(vessel: VesselParameters) -> Equations:
    return Equations(vessel.nominal(), vessel.thruster, vessel.name, vessel.inputs)


@pytest.mark.slow
@SOME_AND_THE_OTHERS
def test_their_c_sails_as_they_do(
    names: tuple[str, ...], tmp_path: Path, subtests: pytest.Subtests
) -> None:
    for name in names:
        for ending in ("c", "h"):
            text = equations_of(parameters_of(name)).render(f"model.{ending}", name=name)
            (tmp_path / f"{name}.{ending}").write_text(text)
    library = compiled(*(tmp_path / f"{name}.c" for name in names))
    for name in names:
        with subtests.test(name):
            ours = Ours(parameters_of(name), WIND, CURRENT)
            theirs = Theirs(library, name, ours)
            commands = ours.random_commands(STEPS)
            track = ours.sail(commands, STEP_S)
            assert np.all(np.isfinite(track))
            assert np.any(np.ptp(track[:, -ours.n :], axis=0) > 0.0)
            assert relative(theirs.sail(commands, STEP_S), track) < EQUAL
            check_changes(theirs)


def check_changes(theirs: Theirs) -> None:
    """The exported rates of the inputs are the limit of their exact steps."""
    ours, step_s = theirs.ours, 1e-6
    lag = ours.lag(step_s)
    for command in ours.random_commands(1000)[::50]:
        state = np.concatenate([np.zeros(theirs.size - ours.commands), ours.start])
        state[3 * isinstance(ours.kinematics, Quaternion)] = 1.0
        inputs = np.column_stack([ours.start, 0.0 * ours.start])
        step_lag_kernel(lag, inputs, command)
        change = np.where(lag.direct, 0.0, (inputs[:, 0] - ours.start) / step_s)
        rate = theirs.rates(state, command)[-ours.commands :]
        np.testing.assert_allclose(rate, change, rtol=1e-5, atol=1e-8)


SAIL = """
function track = sail(vessel, g)
    eta = g.eta(:); nu = g.nu(:); h = g.h; track = zeros(numel(nu), size(g.acting, 3));
    for k = 1:size(g.acting, 3)
        a = g.acting(:, :, k);
        [n1, e1] = vessel(eta, nu, a(:, 1), g.wind, g.current);
        [n2, e2] = vessel(eta + h / 2 * e1, nu + h / 2 * n1, a(:, 2), g.wind, g.current);
        [n3, e3] = vessel(eta + h / 2 * e2, nu + h / 2 * n2, a(:, 2), g.wind, g.current);
        [n4, e4] = vessel(eta + h * e3, nu + h * n3, a(:, 3), g.wind, g.current);
        eta = eta + h / 6 * (e1 + 2 * e2 + 2 * e3 + e4);
        nu = nu + h / 6 * (n1 + 2 * n2 + 2 * n3 + n4);
        track(:, k) = nu;
    end
end
"""


@pytest.mark.parametrize(
    ("names", "steps"), [(DIFFERENT, 50), pytest.param(STEERED, STEPS, marks=pytest.mark.nightly)]
)
def test_octave_sails_as_they_do(
    names: tuple[str, ...], steps: int, tmp_path: Path, subtests: pytest.Subtests
) -> None:
    tracks, given = {}, {}
    for name in names:
        vessel = replace(parameters_of(name), attitude="euler")
        text = equations_of(vessel).in_angles.render("mss.m", name=name)
        (tmp_path / f"{name}.m").write_text(text)
        ours = Ours(vessel, WIND, CURRENT)
        tracks[name] = ours.sail(ours.random_commands(steps), STEP_S)[:, -ours.n :]
        given[name] = {
            "eta": np.zeros(ours.n), "nu": ours.nu_start, "h": STEP_S, "wind": WIND,
            "current": CURRENT, "acting": ours.acting.transpose(2, 1, 0),
        }  # fmt: skip
    (tmp_path / "sail.m").write_text(SAIL)
    program = (
        "g = load('given.mat'); for name = fieldnames(g)' n = name{1};"
        "answer.(n) = sail(str2func(n), g.(n)); end; save('-v7', 'answer.mat', 'answer')"
    )
    answer = octave(program, tmp_path, given)["answer"]
    for name in names:
        with subtests.test(name):
            theirs = np.reshape(answer[name], (-1, steps)).T
            assert relative(theirs, tracks[name]) < EQUAL


@pytest.mark.parametrize("name", [*DIFFERENT, "supply_vessel", "milliampere"])
def test_the_vehicle_for_python_vehicle_simulator_moves_as_its_loop_says(name: str) -> None:
    """Its main loop calls nu, u = dynamics(eta, nu, u, command, h), one step of Euler's method."""
    vessel = replace(parameters_of(name), attitude="euler")
    ours, equations, scope = Ours(vessel, WIND, CURRENT), equations_of(vessel), {}
    text = equations.render("pvs.py", name=name, start=[*ours.start], length=1.0)
    exec(compile(text, name, "exec"), scope)
    commands, indices, h = ours.random_commands(2000)[::50], equations.indices, 0.01
    speed, direction = np.hypot(*CURRENT), np.degrees(np.arctan2(*CURRENT[::-1]))
    boat = scope[name](commands[0], V_c=speed, beta_c=direction, wind=WIND)
    assert boat.controlMode == "stepInput"
    np.testing.assert_array_equal(boat.stepInput(0.0), commands[0])
    rng, acts = np.random.default_rng(4), ours.start
    limits = vessel.velocity_limits or vessel.scales.velocity_limits
    for command in commands:
        eta, nu = np.zeros(6), np.zeros(6)
        eta[indices] = rng.uniform(-1.0, 1.0, size=ours.n)
        nu[indices] = rng.uniform(-0.3, 0.3, size=ours.n) * limits
        if equations.lag is None:
            acts = command
        acts = np.where(ours.lag(h).direct, command, acts)
        nu_dot = ours.rates(eta[indices], nu[indices], acts)[-ours.n :]
        after, acting = boat.dynamics(eta, nu, acts, command, h)
        scale = np.max(np.abs(h * nu_dot)) + 1e-300
        assert np.max(np.abs(after[indices] - nu[indices] - h * nu_dot)) < EQUAL * scale
        if vessel.inputs:
            exact = np.column_stack([acts, 0.0 * acts])
            step_lag_kernel(ours.lag(1e-6), exact, command)
            np.testing.assert_allclose(acting - acts, (exact[:, 0] - acts) * h / 1e-6, rtol=1e-4)
        acts = acting
