"""The code of docs/howto/python.md runs in an empty folder, and does what the page says."""

import re
from pathlib import Path

import pytest

from tests.runner.programs import ROOT, ended, program

PAGE = ROOT / "docs" / "howto" / "python.md"
CHECKS = """
assert run.status == "finished"
assert (len(sweep.runs()), len(pairs.runs())) == (4, 2)
assert table.frame["identifier"].tolist() == ["none", "ls"]
assert 0.0 < run.metric("e_pos_mae", dof="position") < 1.0
assert len(axes.patches) == 2
assert again.logbook.model(again.number, "nominal").coefficients.equals(model.coefficients)
assert estimator.score(test) > 0.99
assert ferry.dofs == ("surge", "sway", "yaw")
"""


def script() -> str:
    """The code of the page, with the checks."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert len(blocks) == 7
    return "".join([*blocks, CHECKS])


@pytest.mark.slow
def test_the_code_of_the_guide_runs(tmp_path: Path) -> None:
    (tmp_path / "guide.py").write_text(script())
    code, out, err = ended(program("guide.py", folder=tmp_path))
    assert code == 0, err
    assert out.startswith("identifier: no option 'lss', did you mean ls? expected one of")
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"guide.py", "results", "track.pdf", "ferry.c", "ferry.h"}
    for link in re.findall(r"\((\.\./notebooks/\w+\.ipynb)\)", PAGE.read_text()):
        assert (PAGE.parent / link).is_file()
