"""The pages of the guide: links that hold, and commands that cannot be wrong unnoticed."""

import re
from pathlib import Path

import pytest

from docs.guide import ROOT, Folder, MismatchError, agree, check, pages, steps

LINK = re.compile(r"\]\((?!https?://)([^)\s]+)\)|(?:src|srcset)=\"([^\"]+)\"")
HEADING = re.compile(r"^#+ (.+)$", re.MULTILINE)
DOCUMENTS = (*pages(), *(ROOT / "docs").glob("*.md"), *ROOT.glob("*.md"))


def anchor(heading: str) -> str:
    """The anchor that GitHub and MkDocs give a heading."""
    plain = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
    return re.sub(r"\s+", "-", re.sub(r"[^\w\s-]", "", plain).strip())


def prose(text: str) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)


def test_links_of_the_pages_hold() -> None:
    lost = []
    for page in DOCUMENTS:
        for found in LINK.finditer(prose(page.read_text(encoding="utf-8"))):
            path, _, at = (found[1] or found[2]).partition("#")
            target = (page.parent / path).resolve() if path else page
            there = target.exists() and ROOT in target.parents
            if there and at:
                headings = HEADING.findall(prose(target.read_text(encoding="utf-8")))
                there = at in map(anchor, headings)
            if not there:
                lost.append((page.name, found[0]))
    assert lost == []


def test_code_without_a_file_is_only_in_the_guide_to_python() -> None:
    """Its blocks are run by tests/test_wheel.py; others would be run by none."""
    for page in pages():
        blocks = re.findall(r"^```python\n(.*)$", page.read_text(), re.MULTILINE)
        named = [line for line in blocks if re.match(r"# [\w./]+\.py$", line)]
        assert named == blocks or page.stem == "python", page


PAGE = """
```yaml
# own/name.yaml
a: 1
```

<!-- run: echo 3 > three -->
```console
$ cat own/name.yaml
a: 1
$ printf '%s\\n' first 0.50004 "$(cat three)" \\
    last
first
0.5
...
last
```

<!-- test: exit 3; 9 -> 3 -->
```console
$ sh -c 'echo no >&2; exit 9'
no
```
"""


def test_files_commands_and_outputs_of_a_page(tmp_path: Path) -> None:
    assert [step.line for step in steps(PAGE) if step.command] == [7, 9, 11, 21]
    assert check(PAGE, Folder(tmp_path)) == ""


def test_what_is_wrong_on_a_page_fails(tmp_path: Path) -> None:
    for number, (right, wrong, said) in enumerate((
        ("cat own/name.yaml", "cat own/nam.yaml", "line 9: .*\nexit code 1"),
        ("a: 1\n$", "a: 2\n$", "line 9: .*\nshown:\na: 2\nis:\na: 1"),
        ("0.5\n", "0.51\n", "line 11: "),
        ("...\n", "", "line 11: "),
        ("exit 3", "exit 2", "line 21: .*\nexit code 3"),
        ("9 -> 3", "8 -> 3", "'8' is to be replaced and is not there"),
    )):  # fmt: skip
        assert PAGE.count(right) == 1
        folder = tmp_path / str(number)
        folder.mkdir()
        with pytest.raises(MismatchError, match=said):
            check(PAGE.replace(right, wrong), Folder(folder))


def test_a_page_stops_where_something_is_missing(tmp_path: Path) -> None:
    text = PAGE.replace("exit 3;", "needs no_such_program;")
    assert check(text, Folder(tmp_path)) == "no_such_program is not here"


def test_loose_outputs_have_other_numbers_and_the_same_words() -> None:
    shown = ["| none | **0.38 ± 0.02 (n=20)** |"]
    assert agree(shown, ["| none | 0.41 ± 0.1 (n=2) |"], loose=True)
    assert not agree(shown, ["| none | 0.41 ± 0.1 (n=2) |"])
    assert not agree(shown, ["| ls | 0.41 ± 0.1 (n=2) |"], loose=True)


COMMANDED = {
    page.relative_to(ROOT).as_posix(): page
    for page in sorted({*pages(), *(ROOT / "docs").rglob("*.md")})
    if any(steps(page.read_text()))
}


def test_the_pages_with_commands_are_found() -> None:
    known = {"README.md", "docs/published.md", "docs/explanation/plsr.md", "docs/howto/weather.md"}
    assert known <= set(COMMANDED)


@pytest.mark.nightly
@pytest.mark.parametrize("name", COMMANDED)
def test_commands_of_a_page(name: str, tmp_path: Path) -> None:
    """What a new user does: the commands of a page, in an empty folder."""
    if missing := check(COMMANDED[name].read_text(), Folder(tmp_path)):
        pytest.skip(missing)
