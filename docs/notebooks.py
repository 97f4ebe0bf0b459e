"""Execute the notebooks of docs/notebooks, each in an empty folder, and write their outputs.

`python -m docs.notebooks` executes all of them, `python -m docs.notebooks first_trial` one. They
need nbclient and ipykernel (the extra `test`), own_recording the data in SEATRIAL_DATA.
"""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat

FOLDER = Path(__file__).with_name("notebooks")
LONGEST_S = 300  # of one cell
KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}


def executed(path: Path, folder: Path) -> Any:
    """Return the notebook at a path with its outputs; the working folder is `folder`.

    Raises nbclient.exceptions.CellExecutionError if a cell fails.
    """
    from nbclient import NotebookClient  # not needed to read them

    notebook = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": str(folder)}}
    NotebookClient(
        notebook, timeout=LONGEST_S, kernel_name=KERNEL["name"], resources=where
    ).execute()
    notebook.metadata = {"kernelspec": KERNEL, "language_info": {"name": "python"}}
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"
        cell.metadata = {}  # without the times of the execution
    return notebook


def main(names: list[str]) -> None:
    """Execute the named notebooks, by default all."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        if not names or path.stem in names:
            with TemporaryDirectory() as folder:
                notebook = executed(path, Path(folder))
            nbformat.write(notebook, path)
            print(path.name)


if __name__ == "__main__":
    main(sys.argv[1:])
