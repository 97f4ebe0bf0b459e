"""Parts from elsewhere that fail: one line with their name, and a failed run; a sweep goes on."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from seatrial.runner.record import catalogue
from tests.runner.command import Answer, Command

FIT = """
from dataclasses import dataclass
import numpy as np
from seatrial.models.identification.problem import Identified, Identifier
from seatrial.models.vessel.table import Vessel

@dataclass(frozen=True)
class Fit(Identifier):
    gain: float = 1.0

    def identify(self, problem, rng):
        nominal = problem.nominal
        {body}
"""
WAVE = """
from dataclasses import dataclass
import numpy as np
from seatrial.models.weather.weather import Force

@dataclass(frozen=True)
class Wave(Force):
    def realise(self, n, dofs, period_s, rng):
        {body}
"""
HELM = """
from dataclasses import dataclass
from typing import NamedTuple
import numpy as np
from seatrial.models.compiled import lean_kernel
from seatrial.models.control.controller import Controller
from seatrial.models.control.controller import PythonController
from seatrial.models.simulation.registry import CONTROLLERS

class Table(NamedTuple):
    gains: np.ndarray

class Unknown(NamedTuple):
    gains: np.ndarray

def step(table, state, eta, nu, eta_d, nu_d, nu_dot_d, tau, tau_fb):
    {step}

CONTROLLERS[Table] = {wrap}(step)

@dataclass(frozen=True)
class Helm(Controller):
    def build(self, model, period_s):
        return {built}

@dataclass(frozen=True)
class Tiller(PythonController):
    def command(self, design, state, now):
        {step}
"""
COURSE = """
from dataclasses import dataclass
import numpy as np
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.missions import Mission
from seatrial.models.simulation.registry import Timetable

@dataclass(frozen=True)
class Course(Mission):
    reference_filter: Reference
    duration_s: float = 20.0

    def guidance(self, t, start):
        return {guidance}

    def force(self, t, dofs, rng):
        return {force}
"""
BUILT = "Table(np.zeros(3)), np.zeros(1)"
STILL = "Timetable(np.zeros((len(t), 3))), np.zeros(1)"
SPEED = """
from collections.abc import Mapping
from dataclasses import dataclass
from seatrial.runner.record.catalogue import Definition
from seatrial.runner.record.own_metrics import OwnMetric

@dataclass(frozen=True)
class Speed(OwnMetric):
    definition = Definition("{name}", ("validation",), {{"surge": "m/s"}}, None, "Speed", "")

    def of_model(self, held_out, model):
        {body}
"""
SHORT = (*("vessel=surge_linear", "excitation=prbs", "controller=none", "evaluation=none"),)


def fit(body: str) -> tuple[str, str]:
    """The text of a module with an identifier, and the option that names it."""
    return FIT.format(body=body), "identifier._target_={module}.Fit"


def wave(body: str) -> tuple[str, str]:
    return WAVE.format(body=body), "+disturbance.others={{wave: {{_target_: {module}.Wave}}}}"


def speed(name: str, body: str) -> tuple[str, str]:
    return SPEED.format(name=name, body=body), "metrics=[{{_target_: {module}.Speed}}]"


NO_FIT = fit("return None")
# Each module: its text and the option that names it, and the line.
FAILING = {
    "raises": (fit("raise ZeroDivisionError('no\\n  wind')"), "Fit: ZeroDivisionError: no wind"),
    # the exception is raised in a library, but comes through the plug-in
    "calls": (fit("np.linalg.solve(np.zeros((2, 2)), np.zeros(2))"), "Fit: LinAlgError: Singular"),
    "nothing": (NO_FIT, "Fit.identify: got a NoneType, expected an Identified"),
    "nan": (fit("return Identified(np.nan * nominal, nominal)"),
            "Fit.identify: model: got nan at (0, 0), expected finite numbers"),
    "shape": (fit("return Identified(nominal, nominal, std_error=np.zeros(7))"),
              "Fit.identify: std_error: got shape (7,), expected"),
    "gale": (wave("return np.full((n, len(dofs)), np.nan)"),
             "Wave.realise: got nan at (0, 0), expected finite numbers"),
    "measure": (speed("speed_of_tests", "return {'surge': float('nan')}"),
                "Speed.of_model: surge: got nan at (), expected finite numbers"),
    "axis": (speed("axis_of_tests", "return {'roll': 1.0}"),
             "Speed.of_model: metric axis_of_tests: got dof 'roll', expected one of surge"),
}  # fmt: skip
SAILED = ("excitation=waypoints", "excitation.interval_s=5", "evaluation=none")
AT_SEA = {
    "steers": (HELM.format(step="raise OSError('stuck')", wrap="", built=BUILT),
               "Helm: OSError: stuck"),
    "tiller": (HELM.format(step="return np.nan * now.eta", wrap="", built=BUILT),
               "Tiller.command: got nan at (0,), expected finite numbers"),
    "compile": (HELM.format(step="tau[0] = 'ahead' + 1", wrap="lean_kernel", built=BUILT),
                "Helm: TypingError: "),
    "unknown": (HELM.format(step="pass", wrap="", built="Unknown(np.zeros(3)), np.zeros(1)"),
                "Helm.build: got a Unknown, for which no step is registered"),
    "force": (COURSE.format(guidance=STILL, force="np.full((len(t), 3), np.inf)"),
              "Course.force: got inf at (0, 0), expected finite numbers"),
}  # fmt: skip
NAMED, IMPORT = NO_FIT[1], "identifier._target_: cannot import {module}.Fit: "
REFUSED = {
    "broken": (("import nothing_of_this_name\n", NAMED), IMPORT + "ModuleNotFoundError: No module"),
    "syntax": (("class Fit(:\n", NAMED), IMPORT + "SyntaxError: invalid syntax"),
    "range": (("from seatrial.models.ranges import Positive\n"
               + NO_FIT[0].replace("gain: float", "gain: Positive"),
               f"+identifier.gain=-1 {NAMED}"), "identifier.gain must be positive, got -1"),
    "role": ((wave("return 0")[0], "identifier._target_={module}.Wave"),
             "identifier: got Wave, expected Identifier"),
    "method": ((NO_FIT[0].replace("identify", "identity"), NAMED),
               "{module}.Fit: TypeError: Can't instantiate abstract class"),
    "checks": ((NO_FIT[0] + "    def check(self, *rest):\n        1 / 0\n", NAMED),
               "{module}.Fit: ZeroDivisionError: division by zero"),
}  # fmt: skip


@pytest.fixture(autouse=True)
def _forget_modules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Modules are found in the working folder; what they declare is forgotten as well."""
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(catalogue, "_declared", dict(catalogue._declared))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if name.startswith("bad_"):
            del sys.modules[name]


def written(folder: Path, kind: str, text: str) -> str:
    module = f"bad_{kind}"
    (folder / f"{module}.py").write_text(text)
    importlib.invalidate_caches()
    return module


def check_failed(answer: Answer, line: str) -> None:
    """A command ended with one line of a failed run."""
    assert answer.code == 1, answer
    last = answer.err.splitlines()[-1]
    assert last.startswith("seatrial: run ")
    assert " failed: " in last
    assert line in last
    assert "Traceback" not in answer.err


@pytest.mark.slow
def test_a_failing_part_fails_its_trial_in_one_line(
    seatrial: Command, subtests: pytest.Subtests
) -> None:
    for kind, ((text, option), line) in FAILING.items():
        with subtests.test(kind):
            module = written(seatrial.folder, kind, text)
            answer = seatrial(*SHORT, "identifier=none", option.format(module=module))
            check_failed(answer, f"{module}.{line}")


@pytest.mark.slow
def test_a_part_that_fails_at_sea_fails_its_trial_in_one_line(
    seatrial: Command, subtests: pytest.Subtests
) -> None:
    conf, step = seatrial.folder / "conf", "seatrial.models.excitation.setpoints.Step"
    for group in ("excitation", "controller"):
        (conf / group).mkdir(parents=True)
    for kind, (text, line) in AT_SEA.items():
        module = written(seatrial.folder, kind, text)
        if "class Course" in text:
            (conf / "excitation" / f"{kind}.yaml").write_text(
                f"_target_: {module}.Course\nreference_filter: {{_target_: {step}}}\n"
            )
            trial: tuple[str, ...] = (f"excitation={kind}", "evaluation=none")
        else:
            part = "Tiller" if kind == "tiller" else "Helm"
            (conf / "controller" / f"{kind}.yaml").write_text(f"_target_: {module}.{part}\n")
            trial = (f"controller={kind}", *SAILED)
        with subtests.test(kind):
            check_failed(seatrial(*trial, "identifier=none"), f"{module}.{line}")


def test_what_is_no_part_is_refused_before_the_start(
    seatrial: Command, subtests: pytest.Subtests
) -> None:
    for kind, ((text, option), line) in REFUSED.items():
        with subtests.test(kind):
            module = written(seatrial.folder, kind, text)
            words = option.format(module=module).split()
            answer = seatrial(*SHORT, "identifier=none", *words)
            assert (answer.code, answer.err.count("\n")) == (2, 1), answer
            assert line.format(module=module) in answer.err
    assert not (seatrial.folder / "results").exists()


def test_the_sweep_goes_on(seatrial: Command) -> None:
    (text, option), line = FAILING["raises"]
    module = written(seatrial.folder, "raises", text)
    variants = [f"--variant={option.format(module=module)}", "--variant=seed=1"]
    answer = seatrial("-m", *variants, *SHORT, "identifier=none")
    assert answer.code == 1, answer
    assert "2 runs: 1 finished, 1 failed" in answer.out
    assert f"{module}.{line}" in answer.out


def test_a_bug_of_ours_stays_a_bug(seatrial: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failure that does not come through the plug-in is not said to be its own."""
    from seatrial.runner.trials import trial as trials

    text, others = wave("return np.zeros((n, len(dofs)))")
    module = written(seatrial.folder, "idle", text)

    def broken(*_: object) -> None:
        raise KeyError("ours")

    monkeypatch.setattr(trials, "of_excitation", broken)
    answer = seatrial(*SHORT, "identifier=none", others.format(module=module))
    assert answer.code == 1
    assert "ours" in answer.err
    assert module not in answer.err
