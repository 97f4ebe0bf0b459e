"""Parts from elsewhere that fail: one line with their name, and a failed run; a sweep goes on."""

import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

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
# module, its text, the option that names it, the line
FAILING = {
    "raises": (
        FIT.format(body="raise ZeroDivisionError('no\\n  wind')"),
        "identifier._target_={module}.Fit",
        "{module}.Fit: ZeroDivisionError: no wind",
    ),
    "calls": (  # the exception is raised in a library, but comes through the plug-in
        FIT.format(body="np.linalg.solve(np.zeros((2, 2)), np.zeros(2))"),
        "identifier._target_={module}.Fit",
        "{module}.Fit: LinAlgError: Singular matrix",
    ),
    "nothing": (
        FIT.format(body="return None"),
        "identifier._target_={module}.Fit",
        "{module}.Fit.identify: got a NoneType, expected an Identified",
    ),
    "nan": (
        FIT.format(body="return Identified(np.nan * nominal, nominal)"),
        "identifier._target_={module}.Fit",
        "{module}.Fit.identify: model: got nan at (0, 0), expected finite numbers",
    ),
    "shape": (
        FIT.format(body="return Identified(nominal, nominal, std_error=np.zeros(7))"),
        "identifier._target_={module}.Fit",
        "{module}.Fit.identify: std_error: got shape (7,), expected",
    ),
    "axes": (
        FIT.format(body="return Identified(Vessel('x', ('yaw',), (), np.zeros((0, 1))), nominal)"),
        "identifier._target_={module}.Fit",
        "{module}.Fit.identify: model: got a model in yaw, expected surge",
    ),
    "gale": (
        WAVE.format(body="return np.full((n, len(dofs)), np.nan)"),
        "+disturbance.others={{gale: {{_target_: {module}.Wave}}}}",
        "{module}.Wave.realise: got nan at (0, 0), expected finite numbers",
    ),
    "swell": (
        WAVE.format(body="return np.zeros((n, 7))"),
        "+disturbance.others={{swell: {{_target_: {module}.Wave}}}}",
        "{module}.Wave.realise: got shape (",
    ),
    "word": (
        WAVE.format(body="return 'calm'"),
        "+disturbance.others={{word: {{_target_: {module}.Wave}}}}",
        "{module}.Wave.realise: got a str, expected (",
    ),
    "measure": (
        SPEED.format(name="speed_of_tests", body="return {'surge': float('nan')}"),
        "metrics=[{{_target_: {module}.Speed}}]",
        "{module}.Speed.of_model: surge: got nan at (), expected finite numbers",
    ),
    "axis": (
        SPEED.format(name="axis_of_tests", body="return {'roll': 1.0}"),
        "metrics=[{{_target_: {module}.Speed}}]",
        "{module}.Speed.of_model: metric axis_of_tests: got dof 'roll', expected one of surge",
    ),
}
SAILED = ("excitation=waypoints", "excitation.interval_s=5", "evaluation=none")
AT_SEA = {
    "steers": (
        HELM.format(step="raise OSError('stuck')", wrap="", built=BUILT),
        "{module}.Helm: OSError: stuck",
    ),
    "tiller": (
        HELM.format(step="return np.nan * now.eta", wrap="", built=BUILT),
        "{module}.Tiller.command: got nan at (0,), expected finite numbers",
    ),
    "compile": (  # text and a number
        HELM.format(step="tau[0] = 'ahead' + 1", wrap="lean_kernel", built=BUILT),
        "{module}.Helm: TypingError: ",
    ),
    "unknown": (
        HELM.format(step="pass", wrap="", built="Unknown(np.zeros(3)), np.zeros(1)"),
        "{module}.Helm.build: got a Unknown, for which no step is registered",
    ),
    "unbuilt": (
        HELM.format(step="pass", wrap="", built="3"),
        "{module}.Helm.build: got int, expected parameters and a state",
    ),
    "force": (
        COURSE.format(guidance=STILL, force="np.full((len(t), 3), np.inf)"),
        "{module}.Course.force: got inf at (0, 0), expected finite numbers",
    ),
    "setpoints": (
        COURSE.format(guidance=STILL.replace("3)", "2)"), force="None"),
        "{module}.Course.guidance: got shape (200, 2), expected (200, 3)",
    ),
}
REFUSED = {
    "broken": (
        "import nothing_of_this_name\n",
        "identifier._target_={module}.Fit",
        "identifier._target_: cannot import {module}.Fit: ModuleNotFoundError: No module named",
    ),
    "syntax": (
        "class Fit(:\n",
        "identifier._target_={module}.Fit",
        "identifier._target_: cannot import {module}.Fit: SyntaxError: invalid syntax",
    ),
    "leaves": (
        "raise SystemExit(3)\n",
        "identifier._target_={module}.Fit",
        "identifier._target_: cannot import {module}.Fit: SystemExit: 3",
    ),
    "range": (
        "from seatrial.models.ranges import Positive\n"
        + FIT.format(body="return None").replace("gain: float", "gain: Positive"),
        "+identifier.gain=-1 identifier._target_={module}.Fit",
        "identifier.gain must be positive, got -1",
    ),
    "role": (
        WAVE.format(body="return 0"),
        "identifier._target_={module}.Wave",
        "identifier._target_: got Wave, expected a class for this group",
    ),
    "method": (
        FIT.format(body="return None").replace("identify", "identity"),
        "identifier._target_={module}.Fit",
        "{module}.Fit: TypeError: Can't instantiate abstract class",
    ),
    "made": (
        FIT.format(body="return None") + "    def __post_init__(self):\n        1 / 0\n",
        "identifier._target_={module}.Fit",
        "{module}.Fit: ZeroDivisionError: division by zero",
    ),
    "checks": (
        FIT.format(body="return None") + "    def check(self, *rest):\n        1 / 0\n",
        "identifier._target_={module}.Fit",
        "{module}.Fit: ZeroDivisionError: division by zero",
    ),
}


@pytest.fixture(autouse=True)
def _forget_modules() -> Iterator[None]:
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        if name.startswith("bad_"):
            del sys.modules[name]


def written(folder: Path, kind: str, text: str, monkeypatch: pytest.MonkeyPatch) -> str:
    module = f"bad_{kind}"
    (folder / f"{module}.py").write_text(text)
    monkeypatch.syspath_prepend(folder)
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


def test_a_failing_part_fails_its_trial_in_one_line(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    for kind, (text, option, line) in FAILING.items():
        with subtests.test(kind):
            module = written(seatrial.folder, kind, text, monkeypatch)
            answer = seatrial(*SHORT, "identifier=none", option.format(module=module))
            check_failed(answer, line.format(module=module))


def test_a_part_that_fails_at_sea_fails_its_trial_in_one_line(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    conf, step = seatrial.folder / "conf", "seatrial.models.excitation.setpoints.Step"
    for group in ("excitation", "controller"):
        (conf / group).mkdir(parents=True)
    for kind, (text, line) in AT_SEA.items():
        module = written(seatrial.folder, kind, text, monkeypatch)
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
            check_failed(seatrial(*trial, "identifier=none"), line.format(module=module))


def test_what_is_no_part_is_refused_before_the_start(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch, subtests: pytest.Subtests
) -> None:
    for kind, (text, option, line) in REFUSED.items():
        with subtests.test(kind):
            module = written(seatrial.folder, kind, text, monkeypatch)
            words = option.format(module=module).split()
            answer = seatrial(*SHORT, "identifier=none", *words)
            assert (answer.code, answer.err.count("\n")) == (2, 1), answer
            assert line.format(module=module) in answer.err
    assert not (seatrial.folder / "results").exists()


def test_nothing_of_a_wrong_role_is_made(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (
        "from dataclasses import dataclass\nfrom pathlib import Path\n@dataclass\n"
        "class Fit:\n    def __post_init__(self):\n        Path('made').touch()\n"
    )
    module = written(seatrial.folder, "spy", text, monkeypatch)
    for option in ("identifier._target_={}.Fit", "metrics=[{{_target_: {}.Fit}}]"):
        answer = seatrial(*SHORT, "identifier=none", option.format(module))
        assert answer.code == 2, answer
        assert "got Fit, expected a class for this group" in answer.err
    assert not (seatrial.folder / "made").exists()


def test_the_sweep_goes_on(seatrial: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    text, option, line = FAILING["raises"]
    module = written(seatrial.folder, "raises", text, monkeypatch)
    variants = [f"--variant={option.format(module=module)}", "--variant=seed=1"]
    answer = seatrial("-m", *variants, *SHORT, "identifier=none")
    assert answer.code == 1, answer
    assert "2 runs: 1 finished, 1 failed" in answer.out
    assert line.format(module=module) in answer.out


def test_a_bug_of_ours_stays_a_bug(seatrial: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """A failure that does not come through the plug-in is not said to be its own."""
    from seatrial.runner import trial as trials

    module = written(
        seatrial.folder, "idle", WAVE.format(body="return np.zeros((n, len(dofs)))"), monkeypatch
    )

    def broken(*_: object) -> None:
        raise KeyError("ours")

    monkeypatch.setattr(trials, "excitation_report", broken)
    others = f"+disturbance.others={{idle: {{_target_: {module}.Wave}}}}"
    answer = seatrial(*SHORT, "identifier=none", others)
    assert answer.code == 1
    assert "ours" in answer.err
    assert module not in answer.err
