"""The code of docs/python.md runs in an empty folder, and does what the page says."""

import re
from pathlib import Path

from tests.runner.programs import ROOT, ended, program

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


def test_the_code_of_the_guide_runs(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "python.md").read_text()
    blocks = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 7
    (tmp_path / "guide.py").write_text("".join([*blocks, CHECKS]))
    code, out, err = ended(program("guide.py", folder=tmp_path))
    assert code == 0, err
    assert out.startswith("identifier: no option 'lss', did you mean ls? expected one of")
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"guide.py", "results", "track.pdf", "ferry.c", "ferry.h"}
    for link in re.findall(r"\((notebooks/\w+\.ipynb)\)", page):
        assert (ROOT / "docs" / link).is_file()
