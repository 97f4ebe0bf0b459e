"""Identification by another program: what it reads, what it may write, and how it fails."""

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, PartError
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.runner.configuration.fingerprint import fingerprint
from seatrial.runner.trials.command_identifier import CommandIdentifier

DOFS = ("surge", "sway", "yaw")
TERMS = basis.terms(["u_dot", "v_dot", "r_dot", "u", "v", "r"])
NOMINAL = Vessel("ship", DOFS, TERMS, np.vstack([np.diag([10.0, 20, 30]), np.diag([1.0, 2, 3])]))
LAG = SecondOrderLag(natural_frequency_rad_s=2.0, damping=0.8)
START = "import json, os, sys, time\nfolder = sys.argv[1]\n"


def problem() -> Problem:
    rng = np.random.default_rng(0)
    eta, nu, nu_dot, tau = rng.normal(size=(4, 50, 3))
    recording = Recording(
        DOFS, 0.5 * np.arange(50), eta, nu, nu_dot, tau, np.zeros((50, 3)),
        tau_filtered=0.5 * tau, tau_actual=0.7 * tau, wind=rng.normal(size=(50, 2)),
    )  # fmt: skip
    return Problem(recording, recording, NOMINAL, LAG)


def by(folder: Path, text: str, **options: Any) -> Identified:
    """What a program finds; `text` is its source."""
    program = folder / "program.py"
    program.write_text(START + text)
    identifier = CommandIdentifier((sys.executable, str(program)), **options)
    return identifier.identify(problem(), np.random.default_rng(0))


def answer(*lines: str, header: str = "term,dof,value") -> str:
    """The source that writes the coefficients."""
    content = "\n".join([header, *lines]).encode()
    return f"open(os.path.join(folder, 'coefficients.csv'), 'wb').write({content!r})\n"


def test_the_program_reads_the_problem_and_the_recording(tmp_path: Path) -> None:
    copy = f"import shutil\nshutil.copytree(folder, {str(tmp_path / 'copy')!r})\n"
    by(tmp_path, copy + answer("u,surge,1.0"))
    read = json.loads((tmp_path / "copy" / "problem.json").read_text())
    given = problem().training
    head = [read[key] for key in ("version", "vessel", "dofs", "sample_time_s")]
    assert head == [1, "ship", [*DOFS], 0.5]
    assert read["thruster"]["natural_frequency_rad_s"] == 2.0
    assert {"term": "v_dot", "dof": "sway", "value": 20.0, "unit": "kg"} in read["nominal"]
    assert len(read["nominal"]) == 6
    path = tmp_path / "copy" / read["recording"]
    names = path.read_text().partition("\n")[0].split(",")
    columns = dict(zip(names, np.loadtxt(path, delimiter=",", skiprows=1).T, strict=True))
    assert list(columns) == list(read["columns"])
    for words, values in (
        ("t", given.t[:, None]),
        ("x y psi", given.eta),
        ("u v r", given.nu),
        ("u_dot v_dot r_dot", given.nu_dot),
        ("tau_surge tau_sway tau_yaw", given.tau),
        ("tau_actual_surge tau_actual_sway tau_actual_yaw", given.tau_actual),
        ("tau_filtered_surge tau_filtered_sway tau_filtered_yaw", given.tau_filtered),
        ("air_ahead air_abeam", given.wind),
    ):
        assert values is not None
        np.testing.assert_array_equal(np.column_stack([columns[n] for n in words.split()]), values)
    assert [read["columns"][name] for name in ("tau_yaw", "air_ahead", "u")] == ["Nm", "m/s", "m/s"]


def test_coefficients_replace_those_of_the_nominal_model(tmp_path: Path) -> None:
    """The file is as a spreadsheet may write it: with a byte order mark, CRLF and empty cells."""
    lines = ("u,surge,5.0,0.25\r", "|u|u,surge,7,\r", "r,yaw,0,0\r")
    found = by(tmp_path, answer(*lines, header="\ufeffterm,dof,value,std_error\r"))
    changed = {("surge", "u"): 5.0, ("surge", "|u|u"): 7.0, ("yaw", "r"): 0.0}
    for dof in DOFS:
        for term in (*TERMS, basis.term("|u|u")):
            expected = changed.get((dof, term.name), NOMINAL.coefficient(dof, term.name))
            assert found.model.coefficient(dof, term.name) == expected
    np.testing.assert_array_equal((found.model - NOMINAL).theta, found.residual.theta)
    assert found.std_error is not None
    errors = {("surge", "u"): 0.25, ("yaw", "r"): 0.0}
    for (i, j), error in np.ndenumerate(found.std_error):
        expected = errors.get((DOFS[j], found.residual.terms[i].name), np.nan)
        np.testing.assert_equal(error, expected)


WRONG = [
    ("print('a'); sys.exit('no  data')", "exit code 1: no data"),
    ("os.kill(os.getpid(), 9)", "ended by signal 9: no message"),
    ("", "got no coefficients.csv, expected one"),
    ("open(folder + '/coefficients.csv', 'wb').write(b'\\xff\\x00')", "csv: got no coefficients, "),
    (answer(), "coefficients.csv: got no coefficients, expected at least one"),
    (answer("u,surge"), "coefficient 1: got {'dof': 'surge', 'term': 'u', 'value': None}"),
    (answer("3", header="u"), "coefficient 1: got {'u': '3'}, expected term, dof (surge, sway, "),
    (answer("u,surge,nan"), "'value': 'nan'}, expected term, dof (surge, sway, yaw), finite value"),
    (answer("u,surge,1,inf", header="term,dof,value,std_error"), "'value': '1'"),
    (answer("u,roll,1"), "'roll', 'term': 'u', 'value': '1'}, expected term, dof (surge, sway, "),
    (answer("zz,surge,1"), "term 'zz': got 'zz', expected factors from"),
    (answer("u,surge,1", "u,surge,1"), "coefficient 2: got u in surge twice"),
    (answer("u,surge,1,2"), "coefficient 1: got "),  # decimal comma
    (answer("u" * 200_000), "field larger than field limit"),
]


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_a_wrong_program_is_named_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(PartError) as caught:
        by(tmp_path, text)
    assert str(caught.value).startswith(f"{sys.executable} {tmp_path}/program.py: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_program_that_hangs_is_ended_with_all_it_started(tmp_path: Path) -> None:
    text = (
        "import subprocess\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
        f"open({str(tmp_path / 'pid')!r}, 'w').write(str(child.pid))\nchild.wait()\n"
    )
    start = time.monotonic()
    with pytest.raises(PartError, match=r"took longer than identifier\.limit_s = 3 s"):
        by(tmp_path, text, limit_s=3.0)
    assert time.monotonic() - start < 60.0
    state = Path("/proc", (tmp_path / "pid").read_text(), "stat")
    for _ in range(50):  # a zombie waits for its parent
        if not state.exists() or state.read_text().rpartition(")")[2].split()[0] == "Z":
            return
        time.sleep(0.1)
    pytest.fail("the child of the program is still running")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"identifier\.command: got none, expected .* such as \[python, fit\.py\]"),
        ({"command": ("no_such_program",)}, r"got 'no_such_program', expected a program"),
        ({"command": (sys.executable,), "files": ("nothing.py",)}, r"files: got 'nothing\.py'"),
    ],
)
def test_a_command_that_cannot_run_is_refused(options: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        CommandIdentifier(**options).check(NOMINAL, LAG, False)


def test_the_programs_count_by_their_content(tmp_path: Path) -> None:
    def of(name: str, program: str, library: str) -> str:
        for file, content in ((name, program), ("library.py", library)):
            (tmp_path / file).write_text(content)
        command, files = ["python", str(tmp_path / name)], [str(tmp_path / "library.py")]
        return fingerprint({"identifier": {"command": command, "files": files}}, {}, "sources")

    first = of("fit.py", "1", "1")
    assert of("moved.py", "1", "1") == first
    assert len({first, of("fit.py", "2 ", "1"), of("fit.py", "1", "3  ")}) == 3
