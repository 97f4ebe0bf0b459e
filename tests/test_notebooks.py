"""The notebooks run, and their committed outputs are of this code and of no particular machine."""

import re
from pathlib import Path
from typing import Any

import nbformat
import pytest

from docs.notebooks import FOLDER, executed

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
RUNNING = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.data] * (path.stem == "own_recording"))
    for path in NOTEBOOKS
]
MACHINE = re.compile(r"/(root|home|tmp|usr|work|opt|Users|var)/|[A-Z]:\\\\|site-packages")


def outputs(notebook: Any) -> list[list[tuple[str, ...]]]:
    """What each cell has displayed: the types of the data, or the name of the stream."""
    return [
        [
            ("error", output.ename) if output.output_type == "error" else tuple(sorted(output.data))
            for output in cell.get("outputs", [])
            if output.output_type != "stream"
        ]
        for cell in notebook.cells
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_committed_outputs_name_no_machine(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    shown = 0
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            data = dict(output.get("data", {}))
            shown += bool(data.pop("image/png", ""))
            assert not MACHINE.search("".join([output.get("text", ""), *map(str, data.values())]))
    assert shown > 0 or path.stem == "own_identifier"
    assert [cell.execution_count for cell in notebook.cells if cell.cell_type == "code"] == list(
        range(1, 1 + sum(cell.cell_type == "code" for cell in notebook.cells))
    )


@pytest.mark.nightly
@pytest.mark.parametrize("path", RUNNING)
def test_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("nbclient", "ipykernel"):
        pytest.importorskip(package, reason=f"{package} is not installed: it is in the extra test")
    monkeypatch.setenv("JUPYTER_RUNTIME_DIR", str(tmp_path / "runtime"))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    folder = tmp_path / "empty"
    folder.mkdir()
    notebook = executed(path, folder)
    assert outputs(notebook) == outputs(nbformat.read(path, as_version=4))
    streams = [o for cell in notebook.cells for o in cell.get("outputs", []) if "text" in o]
    assert not any("Traceback" in output.text for output in streams)
