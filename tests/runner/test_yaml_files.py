"""YAML files are checked before their aliases are expanded."""

import time
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from seatrial.models.errors import ConfigurationError
from seatrial.runner.checked_yaml import MOST_NODES, check_file
from seatrial.runner.resolution import check_size
from tests.runner.command import Command

CONF = Path(__file__).parents[2] / "conf"
BOMB = "a: &a0 [x]\n" + "".join(
    f"k{i}: &a{i + 1} [{', '.join([f'*a{i}'] * 9)}]\n" for i in range(30)
)
REFUSED = {
    "bomb": (BOMB, f"line 6: got more than {MOST_NODES} nodes, with aliases"),
    "loop": ("a: &a [*a]\n", "line 1: *a stands for a node around it"),
    "deep": (f"a: {'[' * 1000}{']' * 1000}\n", "line 1: got more than 50 levels"),
    "large": (f"a: {'x' * 1_000_001}\n", "got 1000005 bytes, expected at most 1000000"),
    "open": ("a: [1, 2\n", "expected YAML"),
    "twice": ("a: 1\nb: 2\na: 3\n", "found duplicate key a"),
    "twice_inside": ("a: {b: 1, b: 2}\n", "found duplicate key b"),
    "object": ("a: !!python/object:os.system x\n", "python/object:os.system"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_cannot_be_right(
    name: str, seatrial: Command, tmp_path_factory: pytest.TempPathFactory
) -> None:
    text, message = REFUSED[name]
    folder = tmp_path_factory.mktemp("conf")
    (folder / "vessel").mkdir()
    (folder / "vessel" / f"{name}.yaml").write_text(text)
    begin = time.process_time()
    for mode in ([], ["-m"]):
        said = seatrial.refuses("--config-dir", str(folder), *mode, f"vessel={name}")
        assert f"{name}.yaml" in said
        assert message in said
    assert time.process_time() - begin < 20.0


def test_all_files_of_the_vocabulary_pass() -> None:
    files = sorted(CONF.rglob("*.yaml"))
    assert len(files) > 50
    for path in files:
        check_file(path)


def test_aliases_count_as_often_as_they_stand(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    half = ", ".join("x" * (MOST_NODES // 3 + 1))
    path.write_text(f"a: &a [{half}]\nb: *a\n")
    check_file(path)
    path.write_text(f"a: &a [{half}]\nb: *a\nc: *a\n")
    with pytest.raises(ConfigurationError, match="line 3: got more than"):
        check_file(path)


@pytest.mark.parametrize(
    "reference",
    [
        *("${n%d}", "${ n%d }", "${oc.select:n%d}", "${oc.select: 'n%d' ,0}", "x${n%d}"),
        *("${oc.create:${n%d}}", "${oc.env:NOT_SET,${n%d}}", "${oc.deprecated:n%d}"),
        *("${oc.select:${k}%d}", "${n%d.x}", "${[n%d]}"),
    ],
)
def test_interpolations_of_any_kind_are_counted(reference: str) -> None:
    first = {"x": [1, 2]} if reference.endswith("x}") else [1, 2]
    nodes: dict[str, object] = {"k": "n", "n0": first}
    for i in range(12):
        level = [reference % i] * 10
        nodes[f"n{i + 1}"] = {"x": level} if reference.endswith("x}") else level
    with pytest.raises(ConfigurationError, match="interpolations"):
        check_size(OmegaConf.create(nodes))


def test_interpolations_of_the_values_of_a_node_are_counted() -> None:
    nodes: dict[str, object] = {"n0": {"x": 1, "y": 2}}
    for i in range(12):
        nodes[f"n{i + 1}"] = dict.fromkeys("abcdefghij", f"${{oc.dict.values:n{i}}}")
    with pytest.raises(ConfigurationError, match="interpolations stand for"):
        check_size(OmegaConf.create(nodes))


def test_interpolations_in_a_circle_are_left_to_omegaconf() -> None:
    check_size(OmegaConf.create({"a": "${b}", "b": "${a}", "c": "${a.x}"}))


@pytest.mark.parametrize("level", ["[{0}]", "'{0}'"])  # a list, a text
@pytest.mark.parametrize("sweep", [(), ("-m", "seed=1,2")])
def test_interpolations_that_explode_are_refused(
    seatrial: Command, level: str, sweep: tuple[str, ...]
) -> None:
    words = ["+n0=[1,2]"]
    for i in range(12):
        words.append(f"+n{i + 1}=" + level.format(",".join([f"${{n{i}}}"] * 10)))
    line = seatrial.refuses(*sweep, *words)
    assert "interpolations stand for" in line
    assert "expected at most 100000" in line
