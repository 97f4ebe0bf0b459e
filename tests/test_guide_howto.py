"""The commands of the how-to pages, in empty folders."""

from pathlib import Path

import pytest

from docs.guide import Folder, check, pages

PAGES = {page.stem: page for page in pages() if page.parent.name == "howto"}


@pytest.mark.slow
@pytest.mark.parametrize("name", PAGES)
def test_commands_of_a_page(name: str, tmp_path: Path) -> None:
    if missing := check(PAGES[name].read_text(), Folder(tmp_path)):
        pytest.skip(missing)
