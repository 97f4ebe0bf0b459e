"""The reference of the guide tells everything that the source has, and what it tells is true."""

import re
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import typer.main
import yaml
from omegaconf import OmegaConf
from typer.testing import CliRunner

from docs import gallery
from docs.pages import commands, database, lists, metrics, options
from docs.pages.markdown import code, prose, table
from docs.pages.yaml_options import OptionFile, files, option_file
from seatrial.runner.compare.figures import figures
from seatrial.runner.configuration.hydra_errors import CONF
from seatrial.runner.database.tables import Base
from seatrial.runner.record.catalogue import METRICS
from seatrial.runner.record.vocabulary import GROUPS

DOCS = Path(__file__).parents[2] / "docs"
SVG = "{http://www.w3.org/2000/svg}"


@cache
def described() -> list[tuple[str, OptionFile]]:
    """Every file of options whose page shows them all, with its group."""
    return [(group, one) for group in (*GROUPS[1:], "database") for one in files(group)]


@cache
def inserts(page: str) -> list[list[str]]:
    """The words of the inserts of a page."""
    text = (DOCS / page).read_text()
    return [words.split() for words in re.findall(r"^<!-- insert: (.+?) -->$", text, re.MULTILINE)]


def test_every_metric_is_on_the_page_once() -> None:
    shown = [
        metric.name
        for name, *patterns in inserts("reference/metrics.md")
        if name == "metrics"
        for metric in metrics.selected(*patterns)
    ]
    assert sorted(shown) == sorted(metric.name for metric in METRICS)


def test_every_option_of_a_file_is_described_with_its_default() -> None:
    wrong = []
    for group, file in described():
        node: Any = OmegaConf.to_container(OmegaConf.load(CONF / group / f"{file.name}.yaml")) or {}
        names = {option.name for option in file.options}
        for leaf in leaves(node):
            if not {".".join(leaf[: n + 1]) for n in range(len(leaf))} & names:
                wrong.append((group, file.name, leaf))
        for option in file.options:
            value = value_at(node, option.name.split("."))
            whole = option.default and option.path and not option.default.endswith("…")
            if whole and plain(option.default) != plain(value):
                wrong.append((group, file.name, option.name))
    assert wrong == []


def leaves(node: Any, above: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    if not isinstance(node, dict):
        return [above]
    words = [word for word in node if word not in ("_target_", "defaults")]
    return [leaf for word in words for leaf in leaves(node[word], (*above, str(word)))]


def value_at(node: Any, words: list[str]) -> Any:
    """The value at a path; words may hold a dot."""
    if not words:
        return node
    for n in range(1, len(words) + 1):
        word = ".".join(words[:n])
        if isinstance(node, dict) and word in node:
            return value_at(node[word], words[n:])
    raise KeyError(words)


def plain(value: object) -> str:
    """A value without quotes and spaces, its numbers written in one way."""
    text = re.sub(r"['\"\s]", "", str(value)).replace("None", "null").lower()
    return re.sub(r"\d[\d.]*(?:e[-+]?\d+)?", lambda found: repr(float(found[0])), text)


def test_every_option_has_a_type() -> None:
    """All but what a candidate of `auto` changes, which is an option of another file."""
    untyped = []
    for group, file in described():
        rows = options._table(file.options, file.target or options.DATABASE).splitlines()[2:]
        for option, row in zip(file.options, rows, strict=True):
            kind = row.split(" | ")[2].strip()
            if not kind and option.path and not option.name.startswith("candidates."):
                untyped.append((group, file.name, option.name))
    assert untyped == []


def test_every_group_has_a_page_that_shows_all_its_files() -> None:
    for group in (*GROUPS, "database", "experiment"):
        wanted = {"vessel": ["vessel_class"], "experiment": ["experiments"]}.get(group)
        assert (wanted or ["options", group]) in inserts(f"reference/options/{group}.md")
        if group not in ("database", "experiment", "vessel"):
            assert all(f"](#{one.name})" in lists.parts(group) for one in files(group))
    assert ["trial"] in inserts("reference/options/index.md")
    assert all(code(one.name) in lists.vessel_lines() for one in files("vessel"))
    assert all(code(one.name) in lists.experiments() for one in files("experiment"))


def test_the_options_of_a_trial_are_those_of_its_file() -> None:
    node: Any = OmegaConf.to_container(OmegaConf.load(CONF / "trial.yaml"))
    named = {option.name.partition(".")[0] for option in option_file(CONF / "trial.yaml").options}
    assert named == set(node) - {"defaults", "hydra"}


def test_a_command_has_the_options_of_its_help() -> None:
    sections = re.split(r"^### ", commands.commands("results"), flags=re.MULTILINE)
    program: Any = typer.main.get_command(commands.app)
    for name in program.commands:
        (section,) = [one for one in sections if one.startswith(f"seatrial-results {name}\n")]
        answer = CliRunner().invoke(commands.app, [name, "--help"], env={"COLUMNS": "200"})
        assert answer.exit_code == 0, name
        plain = re.sub(r"\x1b\[[0-9;]*m", "", answer.output)
        listed = set(re.findall(r"^[^\w\n-]*(--[a-z-]+)", plain, re.MULTILINE))
        assert listed, name
        assert listed - {"--help"} <= set(re.findall(r"<code>[^<]*?(--[a-z-]+)", section)), name


def test_the_other_commands_are_those_of_the_program() -> None:
    shown = "".join(commands.commands(one) for one in ("data", "init", "benchmark"))
    for name in ("data check", "data map", "data convert", "data get", "init vessel", "benchmark"):
        assert f"### seatrial {name}\n" in shown


def test_every_table_and_column_of_the_database_is_told_and_drawn() -> None:
    text, drawn = database.tables(), ElementTree.fromstring(database.drawn())
    words = [one.text for one in drawn.iter(f"{SVG}text")]
    for name, held in Base.metadata.tables.items():
        section = text.partition(f"### {name}\n")[2].partition("\n### ")[0]
        assert name in words
        for column in held.columns:
            assert f"| {code(column.name)} |" in section
            assert column.name in words
    keys = sum(len(held.foreign_keys) for held in Base.metadata.tables.values())
    assert len([one for one in drawn.iter(f"{SVG}path") if one.get("marker-end")]) == keys
    for view in ("run_overview", "metric_wide", "coefficient_error", "comparison"):
        assert f"### {view}\n" in text


def test_every_figure_is_in_the_gallery() -> None:
    assert set(gallery.ENTRIES) == set(figures())
    assert {entry.sweep for entry in gallery.ENTRIES.values()} == set(gallery.SWEEPS)
    assert all(entry.look for entry in gallery.ENTRIES.values())


def test_every_public_name_is_in_the_reference() -> None:
    import seatrial

    text = (DOCS / "reference" / "python.md").read_text()
    assert sorted(re.findall(r"^::: seatrial\.(\w+)$", text, re.MULTILINE)) == sorted(
        seatrial.__all__
    )


def test_every_task_of_the_benchmark_is_told() -> None:
    text = lists.benchmark()
    for path in (CONF / "benchmark").glob("*.yaml"):
        held = yaml.safe_load(path.read_text())
        assert f"## {held['title']}\n" in text
        assert all(code(name) in text for name in (*held["cases"], *held["entrants"]))


def test_text_of_the_source_is_no_mark_up() -> None:
    assert prose("a | b_c *d* <e> {f} `g_h`") == (
        "a &#124; b&#95;c &#42;d&#42; &#60;e&#62; &#123;f&#125; <code>g&#95;h</code>"
    )
    assert table(("a", "b"), [["1", "2"]]) == "| a | b |\n| --- | --- |\n| 1 | 2 |\n"
    assert table(("a",), []) == ""
