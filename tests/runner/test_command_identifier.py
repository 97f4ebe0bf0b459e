"""Identification by another program: what it reads, what it may write, and how it fails."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyarrow import parquet

from seatrial.models.errors import ConfigurationError, PartError
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.runner.command_identifier import CommandIdentifier
from seatrial.runner.fingerprint import fingerprint
from tests.runner.command import Command

ROOT = Path(__file__).parents[2]
DOFS = ("surge", "sway", "yaw")
TERMS = basis.terms(["u_dot", "v_dot", "r_dot", "u", "v", "r"])
NOMINAL = Vessel("ship", DOFS, TERMS, np.vstack([np.diag([10.0, 20, 30]), np.diag([1.0, 2, 3])]))
LAG = SecondOrderLag(natural_frequency_rad_s=2.0, damping=0.8)
START = "import json, os, sys, time\nfolder = sys.argv[1]\n"
WRITE = "open(os.path.join(folder, 'coefficients.{}'), 'w').write({!r})\n"


def problem() -> Problem:
    rng = np.random.default_rng(0)
    eta, nu, nu_dot, tau = rng.normal(size=(4, 50, 3))
    wind = rng.normal(size=(50, 2))
    recording = Recording(
        DOFS, 0.5 * np.arange(50), eta, nu, nu_dot, tau, np.zeros((50, 3)),
        tau_filtered=0.5 * tau, tau_actual=0.7 * tau, wind=wind,
    )  # fmt: skip
    return Problem(recording, recording, NOMINAL, LAG)


def by(folder: Path, text: str, **options: Any) -> Identified:
    """What a program finds; `text` is its source."""
    program = folder / "program.py"
    program.write_text(START + text)
    identifier = CommandIdentifier((sys.executable, str(program)), **options)
    return identifier.identify(problem(), np.random.default_rng(0))


def answer(name: str, content: str) -> str:
    return WRITE.format(name, content)


@pytest.mark.parametrize("form", ["parquet", "csv"])
def test_the_program_reads_the_problem_and_the_recording(tmp_path: Path, form: Any) -> None:
    copy = f"import shutil\nshutil.copytree(folder, {str(tmp_path / 'copy')!r})\n"
    content = json.dumps([{"term": "u", "dof": "surge", "value": 5.0}])
    by(tmp_path, copy + answer("json", content), recording=form)
    read = json.loads((tmp_path / "copy" / "problem.json").read_text())
    given = problem().training
    assert read["version"] == 1
    assert (read["vessel"], read["dofs"], read["sample_time_s"]) == ("ship", [*DOFS], 0.5)
    assert read["thruster"]["natural_frequency_rad_s"] == 2.0
    assert {"term": "v_dot", "dof": "sway", "value": 20.0, "unit": "kg"} in read["nominal"]
    assert len(read["nominal"]) == 6
    path = tmp_path / "copy" / read["recording"]
    if form == "csv":
        header = path.read_text().partition("\n")[0].split(",")
        rows = np.loadtxt(path, delimiter=",", skiprows=1)
        columns = dict(zip(header, rows.T, strict=True))
    else:
        table = parquet.read_table(path)
        columns = {name: table[name].to_numpy() for name in table.column_names}
    assert list(columns) == list(read["columns"])
    for names, values in (
        (("x", "y", "psi"), given.eta),
        (("u", "v", "r"), given.nu),
        (("u_dot", "v_dot", "r_dot"), given.nu_dot),
        (tuple(f"tau_{dof}" for dof in DOFS), given.tau),
        (tuple(f"tau_actual_{dof}" for dof in DOFS), given.tau_actual),
        (tuple(f"tau_filtered_{dof}" for dof in DOFS), given.tau_filtered),
        (("air_ahead", "air_abeam"), given.wind),
    ):
        assert values is not None
        np.testing.assert_array_equal(np.column_stack([columns[n] for n in names]), values)
    np.testing.assert_array_equal(columns["t"], given.t)
    assert read["columns"]["tau_yaw"] == "Nm"
    assert read["columns"]["air_ahead"] == read["columns"]["u"] == "m/s"


ROWS = [
    {"term": "u", "dof": "surge", "value": 5.0, "std_error": 0.25},
    {"term": "|u|u", "dof": "surge", "value": 7},
    {"term": "r", "dof": "yaw", "value": 0.0},
]
LINES = "term,dof,value,std_error\nu,surge,5.0,0.25\n|u|u,surge,7,\nr,yaw,0,\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("json", json.dumps({"coefficients": ROWS})),
        ("json", json.dumps(ROWS)),
        ("csv", LINES),
        ("csv", "\ufeff" + LINES.replace("\n", "\r\n")),
    ],
)
def test_coefficients_replace_those_of_the_nominal_model(
    tmp_path: Path, name: str, content: str
) -> None:
    model = f"open(os.path.join(folder, 'coefficients.{name}'), 'wb').write({content.encode()!r})"
    found = by(tmp_path, model)
    changed = {("surge", "u"): 5.0, ("surge", "|u|u"): 7.0, ("yaw", "r"): 0.0}
    for dof in DOFS:
        for term in (*TERMS, basis.term("|u|u")):
            expected = changed.get((dof, term.name), NOMINAL.coefficient(dof, term.name))
            assert found.model.coefficient(dof, term.name) == expected
    np.testing.assert_array_equal((found.model - NOMINAL).theta, found.residual.theta)
    assert found.std_error is not None
    known = np.argwhere(np.isfinite(found.std_error))
    row, column = found.residual.terms.index(basis.term("u")), DOFS.index("surge")
    np.testing.assert_array_equal(known, [[row, column]])
    assert found.std_error[row, column] == 0.25


def row(**changes: Any) -> str:
    return json.dumps([{"term": "u", "dof": "surge", "value": 1.0, **changes}])


WRONG = {
    "fails": ("print('a'); sys.exit('no  data')", "exit code 1: no data"),
    "silent": ("os._exit(7)", "exit code 7: no message"),
    "killed": ("os.kill(os.getpid(), 9)", "ended by signal 9: no message"),
    "nothing": ("", "got none of coefficients.json and coefficients.csv, expected one"),
    "both": (answer("csv", LINES) + answer("json", row()), "got both of"),
    "garbage": (answer("json", "{"), "coefficients.json: Expecting property name"),
    "binary": (
        "open(os.path.join(folder, 'coefficients.csv'), 'wb').write(bytes(range(256)))",
        "coefficients.csv: 'utf-8' codec can't decode",
    ),
    "deep": (answer("json", "[" * 100_000), "coefficients.json: "),
    "object": (answer("json", '{"a": 1}'), "got no list `coefficients`, expected one"),
    "empty": (answer("json", "[]"), "got no coefficients, expected at least one"),
    "number": (answer("json", "[3]"), "coefficient 1: got 3, expected term, dof, value"),
    "nan": (answer("json", row(value=float("nan"))), "value: got nan, expected a finite number"),
    "text": (answer("json", row(value="x")), "value: got 'x', expected a finite number"),
    "true": (answer("json", row(value=True)), "value: got True, expected a finite number"),
    "list": (answer("json", row(value=[1])), "value: got [1], expected a finite number"),
    "error": (answer("json", row(std_error="inf")), "std_error: got 'inf', expected a finite"),
    "dof": (answer("json", row(dof="roll")), "dof: got 'roll', expected one of surge, sway, yaw"),
    "unhashable": (answer("json", row(dof=[])), "dof: got [], expected one of"),
    "term": (answer("json", row(term="zz")), "term 'zz': got 'zz', expected factors from"),
    "twice": (
        answer("json", f"[{row()[1:-1]},{row()[1:-1]}]"),
        "coefficient 2: got u in surge twice",
    ),
    "columns": (answer("csv", "name,value\nu,1\n"), "coefficient 1: got {'name': 'u'"),
    "short": (answer("csv", "term,dof,value\nu,surge\n"), "value: got None, expected a finite"),
    "long": (answer("csv", "term,dof,value\nu,surge,1,2\n"), "coefficient 1: got "),
    "large": (answer("csv", "") + "os.truncate(os.path.join(folder, 'coefficients.csv'), 10**8)",
              "got 100000000 bytes, expected at most"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_a_wrong_program_is_named_in_one_line(tmp_path: Path, kind: str) -> None:
    text, message = WRONG[kind]
    with pytest.raises(PartError) as caught:
        by(tmp_path, text)
    assert str(caught.value).startswith(f"{sys.executable} {tmp_path}/program.py: ")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="there are no process groups")
def test_a_program_that_hangs_is_ended_with_all_it_started(tmp_path: Path) -> None:
    child = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(600)"
    text = (
        "import subprocess\n"
        f"child = subprocess.Popen([sys.executable, '-c', {child!r}])\n"
        f"open({str(tmp_path / 'pids')!r}, 'w').write(f'{{os.getpid()}} {{child.pid}}')\n"
        "child.wait()\n"
    )
    start = time.monotonic()
    with pytest.raises(PartError, match=r"took longer than identifier\.limit_s = 3 s"):
        by(tmp_path, text, limit_s=3.0)
    assert time.monotonic() - start < 60.0
    pids = [int(word) for word in (tmp_path / "pids").read_text().split()]
    assert len(pids) == 2
    for pid in pids:
        assert ended(pid)


def ended(pid: int) -> bool:
    """Whether a process has ended; a zombie, which waits for its parent, has."""
    for _ in range(50):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return True
        state = Path(f"/proc/{pid}/stat")
        if state.exists() and state.read_text().rpartition(")")[2].split()[0] == "Z":
            return True
        time.sleep(0.1)
    os.kill(pid, signal.SIGKILL)
    return False


def test_a_child_that_stays_behind_is_ended_too(tmp_path: Path) -> None:
    text = (
        "import subprocess\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'])\n"
        f"open({str(tmp_path / 'pids')!r}, 'w').write(str(child.pid))\n"
    )
    by(tmp_path, text + answer("json", row()))
    assert ended(int((tmp_path / "pids").read_text()))


def test_the_program_ends_with_a_worker_that_is_killed(tmp_path: Path) -> None:
    (tmp_path / "program.py").write_text(
        START + f"open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid()))\ntime.sleep(600)\n"
    )
    code = (
        "import sys\nfrom tests.runner.test_command_identifier import by, Path\n"
        f"by(Path({str(tmp_path)!r}), open({str(tmp_path / 'program.py')!r}).read())\n"
    )
    worker = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT)
    file, start = tmp_path / "pid", time.monotonic()
    while not (file.exists() and file.read_text()) and time.monotonic() - start < 60.0:
        time.sleep(0.1)
    worker.kill()
    worker.wait()
    assert ended(int(file.read_text()))


def test_the_address_of_the_logbook_is_not_passed_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SEATRIAL_DATABASE", "postgresql://me:secret@host/results")
    by(tmp_path, "assert 'SEATRIAL_DATABASE' not in os.environ\n" + answer("json", row()))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, r"identifier\.command: got none, expected a list such as \[python, fit\.py\]"),
        ({"command": ("no_such_program",)}, r"got 'no_such_program', expected a program"),
        (
            {"command": (sys.executable,), "files": ("nothing.py",)},
            r"identifier\.files: got 'nothing",
        ),
    ],
)
def test_a_command_that_cannot_run_is_refused(options: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        CommandIdentifier(**options).check(NOMINAL, LAG, False)


def test_the_programs_count_by_their_content(tmp_path: Path) -> None:
    program, library = tmp_path / "fit.py", tmp_path / "library.py"
    program.write_text("1")
    library.write_text("1")

    def of(moved: str = "fit.py") -> str:
        command = ["python", str(tmp_path / moved)]
        return fingerprint(
            {"identifier": {"command": command, "files": [str(library)]}}, {}, "sources"
        )

    first = of()
    assert of() == first
    (tmp_path / "moved.py").write_text("1")
    assert of("moved.py") == first
    program.write_text("2 ")
    second = of()
    assert second != first
    library.write_text("3  ")
    assert len({first, second, of()}) == 3


def test_a_sweep_goes_on_after_a_program_that_fails(seatrial: Command) -> None:
    (seatrial.folder / "good.py").write_text(START + answer("json", row(value=15.0)))
    (seatrial.folder / "bad.py").write_text(START + "sys.exit('the data are too short')")
    variants = [
        f"--variant=identifier.command=[{sys.executable},{name}.py]" for name in ("bad", "good")
    ]
    trial = ("vessel=surge_linear", "excitation=prbs", "controller=none", "evaluation=none")
    done = seatrial("-m", *variants, *trial, "identifier=command")
    assert done.code == 1, done
    assert "2 runs: 1 finished, 1 failed" in done.out
    assert f"{sys.executable} bad.py: exit code 1: the data are too short" in done.out
    assert "Traceback" not in done.err
