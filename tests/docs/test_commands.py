"""The commands of the pages beside the tutorials and the how-to pages, in empty folders."""

from pathlib import Path

import pytest

from docs.guide import ROOT, Folder, check, pages, steps

PAGES = {
    page.relative_to(ROOT / "docs").as_posix(): page
    for page in sorted((ROOT / "docs").rglob("*.md"))
    if page not in pages() and any(steps(page.read_text()))
}


def test_there_are_such_pages() -> None:
    assert {"index.md", "published.md", "explanation/plsr.md", "reference/database.md"} <= set(
        PAGES
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_commands_of_a_page(name: str, tmp_path: Path) -> None:
    if missing := check(PAGES[name].read_text(), Folder(tmp_path)):
        pytest.skip(missing)
