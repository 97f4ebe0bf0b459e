"""As a new user would: programs in an empty folder, each a process of its own."""

import os
import re
import signal
import sys
import time
from collections import defaultdict
from pathlib import Path

import pytest

from tests.runner.programs import ROOT, completed, ended, finished, program, wait

GUIDE = ROOT / "docs" / "howto" / "python.md"
BLOCK = re.compile(r'```python(?: title="([^"]+)")?\n(.*?)```', re.DOTALL)


def test_an_import_loads_nothing_slow(tmp_path: Path) -> None:
    code = (
        "import sys, time\n"
        "start = set(sys.modules)\n"
        "import seatrial as st\n"
        "assert {'run', 'sweep', 'open', 'Vessel', 'Recording', 'Estimator'} <= set(dir(st))\n"
        "new = {name.partition('.')[0] for name in set(sys.modules) - start}\n"
        "print(new & {'numpy', 'scipy', 'numba', 'pandas', 'hydra', 'omegaconf', 'sqlalchemy',"
        " 'matplotlib', 'sklearn', 'pydantic', 'typer', 'rich', 'pyarrow'})\n"
        "st.SeatrialError\n"
        "st.open\n"
        "slow = {'numba.core', 'scipy.linalg', 'hydra.core', 'pandas.core', 'sklearn.base'}\n"
        "print(slow & set(sys.modules))\n"
        "st.sail\n"
    )
    code_, out, err = ended(program("-c", code, folder=tmp_path))
    assert (code_, out) == (1, "set()\nset()\n"), err
    assert err.rstrip().endswith("AttributeError: No seatrial attribute sail")


INTERRUPTED = """\
import sys
import seatrial as st

options = dict(identifier="none", evaluation="none", progress=False, launcher=sys.argv[1])
for attempt in range(2):
    try:
        sweep = st.sweep(["seed=range(0,40)"] if not attempt else ["seed=0,1"], **options)
        print("done", len(sweep.runs()), flush=True)
    except KeyboardInterrupt:
        print("interrupted", st.open().runs()["status"].isin(["finished", "interrupted"]).all(),
              flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    "launcher", [pytest.param("basic", marks=pytest.mark.nightly), "processes"]
)
def test_ctrl_c_ends_a_sweep_and_the_session_goes_on(tmp_path: Path, launcher: str) -> None:
    (tmp_path / "script.py").write_text(INTERRUPTED)
    process = program("script.py", launcher, folder=tmp_path)
    wait(lambda: finished(tmp_path) >= 1)
    time.sleep(0.2)
    os.kill(process.pid, signal.SIGINT)
    code, out, err = ended(process)
    assert (code, out.splitlines()) == (0, ["interrupted True", "done 2"]), err
    assert "Traceback" not in err


@pytest.mark.nightly
def test_the_code_of_the_guide_is_typed(tmp_path: Path) -> None:
    """mypy --strict finds nothing in it, and finds what is wrong in a wrong one."""
    files: dict[str, str] = defaultdict(str)
    for name, code in BLOCK.findall(GUIDE.read_text()):
        files[name or "guide.py"] += code
    guide = files["guide.py"]
    wrong = guide.replace("period_s=0.1", 'period_s="fast"').replace('where="', 'state="')
    for name, code in {**files, "wrong.py": wrong}.items():
        (tmp_path / name).write_text(code)
    links = tmp_path / "links" / "seatrial"
    links.mkdir(parents=True)
    for part in ("seatrial/__init__.py", "models", "runner", "conf"):
        (links / Path(part).name).symlink_to(ROOT / part)
    pytest.importorskip("mypy", reason="mypy is not installed: it is in the extra check")

    answer = completed(
        *(sys.executable, "-m", "mypy", "--strict", "--config-file", ROOT / "pyproject.toml"),
        *("--cache-dir", tmp_path / "cache", *files, "wrong.py"),
        folder=tmp_path, MYPYPATH=str(links.parent),
    )  # fmt: skip
    errors = [line for line in answer.stdout.splitlines() if ": error: " in line]
    assert len(errors) == 2, answer
    assert all(line.startswith("wrong.py:") for line in errors)
    assert 'incompatible type "str"; expected "float"' in errors[1]
    assert 'Unexpected keyword argument "state"' in errors[0]
