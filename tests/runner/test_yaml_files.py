"""A file of the configuration that is no YAML is refused in one line, also inside a sweep."""

import pytest

from tests.runner.command import Command

REFUSED = {
    "open": ("a: [1, 2\n", "line 2: expected ',' or ']'"),
    "twice": ("a: 1\nb: 2\na: 3\n", "line 3: found duplicate key a, expected YAML"),
    "inside": ("a: {b: 1, b: 2}\n", "line 1: found duplicate key b, expected YAML"),
    "object": ("a: !!python/object:os.system x\n", "line 1: could not determine a constructor"),
    "loop": ("a: &a [*a]\n", "maximum recursion depth exceeded"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_is_no_yaml(
    name: str, seatrial: Command, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text, message = REFUSED[name]
    folder = tmp_path_factory.mktemp("conf")
    (folder / "vessel").mkdir()
    (folder / "vessel" / f"{name}.yaml").write_text(text)
    for mode in ([], ["-m"]):
        said = seatrial.refuses("--config-dir", str(folder), *mode, f"vessel={name}")
        assert f"{name}.yaml" in said
        assert message in said
