"""Lists of what the groups, the experiments and the benchmark hold, from their YAML files."""

import re
from itertools import takewhile
from typing import Any

import yaml

from docs.pages.markdown import code, prose, table
from docs.pages.yaml_options import files, option_file
from seatrial.runner.configuration.hydra_errors import CONF


def parts(group: str) -> str:
    """The options of a group, a line each, linked to their sections on the same page."""
    rows = [[f"[{code(one.name)}](#{one.name})", _sentence(one.head)] for one in files(group)]
    return table((group, "what it is"), rows)


def vessel_lines() -> str:
    """The rows of the list of vessels."""
    return "\n".join(f"| {code(one.name)} | {_sentence(one.head)} |" for one in files("vessel"))


def _sentence(head: str) -> str:
    """The first sentence of a comment."""
    return prose(re.split(r"(?<=[^.]{2}\.) (?=[A-Z'])", head)[0])


def experiments(folder: str = "conf") -> str:
    """The experiments of a folder of options, a line each."""
    paths = sorted((CONF.parent / folder / "experiment").glob("*.yaml"))
    rows = [[code(one.name), prose(one.head)] for one in map(option_file, paths)]
    return table(("experiment", "what it repeats, and what is done differently"), rows)


def benchmark() -> str:
    """A section for every task: data, cases, entrants and the axes of its score."""
    sections = []
    for path in sorted((CONF / "benchmark").glob("*.yaml")):
        sections.append(_task(path.stem, path.read_text()))
    return "\n".join(sections)


def _task(name: str, text: str) -> str:
    held: dict[str, Any] = yaml.safe_load(text)
    comment = takewhile(lambda line: line.startswith("#"), text.splitlines())
    head = " ".join(line.lstrip("# ") for line in comment)
    source = held.get("source")
    facts = [
        ["trial", code(" ".join(held["trial"]))],
        ["cases", ", ".join(map(code, held["cases"]))],
        ["seeds", str(held.get("seeds", 1))],
        ["axes of the score", ", ".join(held["outputs"])],
        ["entrants", ", ".join(map(code, held["entrants"]))],
    ]
    if source:
        facts += [
            ["data", f"{prose(source['name'])}, <{source['url']}>"],
            ["licence", prose(source["licence"])],
            ["how to get them", prose(source["get"])],
            ["files, with SHA-256", str(len(held.get("files", ())))],
        ]
    return f"## {held['title']}\n\n{prose(head)}\n\n{table(('task', code(name)), facts)}"
