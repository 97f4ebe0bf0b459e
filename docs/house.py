"""The size and the order of the sources: `python -m docs.house [CHECKOUT]`.

Counted are the Python files of `models/` and `runner/`; `docs/areas.csv` says which of them belong
to an area of the plan, by names and patterns (a name goes before a pattern). `--table` prints the
table of CONTRIBUTING.md.
"""

import ast
import csv
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.util import resolve_name
from itertools import combinations
from pathlib import Path

from docs.guide import COMMAND, PART
from docs.refresh import BLOCK

ROOT = Path(__file__).parents[1]
BEFORE = "18ad339"
BEFORE_FIGURES = (60737, 356, 46649, 0, 5, 60, 0)
MOST_ARGUMENTS = 12
MOST_LINES = 60
COMPILERS = ("kernel", "lean_kernel", "njit", "overload")


@dataclass(frozen=True)
class Function:
    """A function or method; `arguments` without self and cls, `lines` without decorators."""

    file: str
    name: str
    lines: int
    arguments: int
    is_kernel: bool

    def __str__(self) -> str:
        return f"{self.file}: {self.name}: {self.lines} lines, {self.arguments} arguments"


def functions(file: str, tree: ast.Module) -> Iterator[Function]:
    """The functions and methods of a file, inner ones too."""
    kernels = {
        argument.id
        for call in ast.walk(tree)
        if isinstance(call, ast.Call) and _name(call.func) in COMPILERS
        for argument in call.args
        if isinstance(argument, ast.Name)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            given = node.args
            named = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
            count = sum(arg is not None and arg.arg not in ("self", "cls") for arg in named)
            lines = (node.end_lineno or node.lineno) - node.lineno + 1
            is_kernel = node.name in kernels or any(
                _name(one) in COMPILERS for one in node.decorator_list
            )
            yield Function(file, node.name, lines, count, is_kernel)


def _name(node: ast.expr) -> str:
    node = node.func if isinstance(node, ast.Call) else node
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def imports(module: str, is_package: bool, tree: ast.Module) -> Iterator[str]:
    """The dotted names that a module imports anywhere, without `seatrial`."""
    package = module if is_package else module.rpartition(".")[0]
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package)
            names = [f"{base}.{alias.name}" for alias in node.names]
        yield from (name.removeprefix("seatrial.") for name in names)


class House:
    """The sources of a checkout and what is counted of them."""

    def __init__(self, checkout: Path = ROOT) -> None:
        self.checkout = checkout
        paths = sorted(
            path for top in ("models", "runner") for path in checkout.glob(f"{top}/**/*.py")
        )
        self.lines = {path.relative_to(checkout).as_posix(): _lines(path) for path in paths}
        self.trees = {file: ast.parse((checkout / file).read_text("utf-8")) for file in self.lines}
        self.functions = [one for file, tree in self.trees.items() for one in functions(file, tree)]

    @cached_property
    def imported(self) -> Mapping[str, set[str]]:
        """The files that each file imports."""
        modules = {
            file.removesuffix(".py").removesuffix("/__init__").replace("/", "."): file
            for file in self.trees
        }

        def files(name: str) -> Iterator[str]:
            while name and name not in modules:
                name = name.rpartition(".")[0]
            if name:
                yield modules[name]

        return {
            file: {
                other
                for name in imports(module, file.endswith("__init__.py"), self.trees[file])
                for other in files(name)
            }
            - {file}
            for module, file in modules.items()
        }

    def circles(self) -> list[list[str]]:
        """The groups of files that import each other."""
        reach = {file: set(others) for file, others in self.imported.items()}
        for between in reach:
            for others in reach.values():
                if between in others:
                    others |= reach[between]
        groups = {
            frozenset(other for other in others if file in reach[other])
            for file, others in reach.items()
            if file in others
        }
        return sorted(sorted(group) for group in groups)

    def mutual_folders(self) -> list[tuple[str, str]]:
        """The pairs of `models`, `runner` and the folders in them that import each other."""
        arrows = {
            (_folder(file), _folder(other))
            for file, others in self.imported.items()
            for other in others
        }
        folders = sorted({_folder(file) for file in self.lines})
        return [(a, b) for a, b in combinations(folders, 2) if {(a, b), (b, a)} <= arrows]

    def too_many_arguments(self) -> list[Function]:
        """Functions with more arguments than a reader keeps apart; kernels take plain arrays."""
        return [f for f in self.functions if f.arguments > MOST_ARGUMENTS and not f.is_kernel]

    def too_long(self) -> list[Function]:
        """Functions that are no longer read at a glance."""
        return [f for f in self.functions if f.lines > MOST_LINES]

    def lines_of(self, folder: str) -> int:
        """The lines of Python of a folder beside the sources."""
        return sum(map(_lines, (self.checkout / folder).glob("**/*.py")))

    def words(self) -> int:
        """The words of README.md, CONTRIBUTING.md and docs that are written by hand.

        Generated tables and the outputs of commands do not count.
        """
        pages = [self.checkout / "README.md", self.checkout / "CONTRIBUTING.md"]
        pages += self.checkout.glob("docs/**/*.md")
        texts = (BLOCK.sub("", page.read_text("utf-8")) for page in pages)
        return sum(len(PART.sub(_without_output, text).split()) for text in texts)

    def figures(self) -> dict[str, int]:
        """What the table counts, in words, and how much of it there is."""
        return {
            "lines of `models/` and `runner/`": sum(self.lines.values()),
            "files": len(self.lines),
            "lines of tests": self.lines_of("tests"),
            "circles of files": len(self.circles()),
            "pairs of folders that import each other": len(self.mutual_folders()),
            "lines of the longest function": max(function.lines for function in self.functions),
            f"functions with more than {MOST_ARGUMENTS} arguments": len(self.too_many_arguments()),
        }

    def areas(self) -> Iterator[tuple[Mapping[str, str], int]]:
        """Each area of the plan, and how many lines it has."""
        with (ROOT / "docs" / "areas.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        named = {name for row in rows for name in row["files"].split()}
        for row in rows:
            files = {
                path.relative_to(self.checkout).as_posix()
                for pattern in row["files"].split()
                for path in self.checkout.glob(pattern)
            }
            own = {*row["files"].split()}
            yield row, sum(self.lines[name] for name in files if name in own or name not in named)


def _lines(path: Path) -> int:
    return len(path.read_text("utf-8").splitlines())


def _without_output(part: re.Match[str]) -> str:
    """A block of a page; of a console only its commands."""
    body = part["body"] or ""
    return "\n".join(COMMAND.findall(body)) if part["kind"] == "console" else body


def _folder(file: str) -> str:
    """The folder of `models` or `runner` that a file is in, or one of these two."""
    parts = file.split("/")
    return "/".join(parts[:2]) if len(parts) > 2 else parts[0]


def main(checkout: Path) -> None:
    """Print the size, the areas and the order of a checkout."""
    house = House(checkout)
    for name, count in house.figures().items():
        print(f"{count:7,}  {name}")
    print(f"{house.lines_of('docs/published'):7,}  lines of docs/published")
    print(f"{house.words():7,}  words of documents\n\narea: {BEFORE}, now")
    for row, count in house.areas():
        words = row["step"], row["issue"], row["area"], row["lines"]
        print("{:>3} {:3} {:32} {:>6}".format(*words), f"{count:6}")
    for pair in house.mutual_folders():
        print(f"import each other: {', '.join(pair)}")
    for circle in house.circles():
        print(f"circle: {', '.join(circle)}")
    for function in dict.fromkeys((*house.too_long(), *house.too_many_arguments())):
        print(function)


if __name__ == "__main__":
    if sys.argv[1:] == ["--table"]:
        print(f"| | {BEFORE} | now |\n|---|---:|---:|")
        for (name, now), before in zip(House().figures().items(), BEFORE_FIGURES, strict=True):
            print(f"| {name} | {before:,} | {now:,} |")
    else:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
