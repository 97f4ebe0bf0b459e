"""The size and the order of the sources: `python -m docs.house [CHECKOUT]`, a Markdown table.

Counted are the Python files of `models/` and `runner/`, beside the same figures at commit 67120c7.

rooms      what imports are counted between: each file and each folder directly under `models/`,
           and `runner/` as one
arrows     pairs of rooms of which one imports the other, for type checks or inside functions too
floors     rooms in the longest chain of such imports
circles    groups of files that import each other, directly or through others, type checks too
"""

import ast
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.util import resolve_name
from pathlib import Path
from statistics import median

ROOT = Path(__file__).parents[1]
BEFORE = "67120c7"
BEFORE_FIGURES = (39, 9, 184, 1, 192, 28658, 8, 71, 3, 3, 342, 122, 86, 10)
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


@dataclass(frozen=True)
class Source:
    """One file of models or runner: its module without `seatrial`, its text and its syntax tree."""

    file: str
    module: str
    text: str

    @cached_property
    def tree(self) -> ast.Module:
        """The syntax tree."""
        return ast.parse(self.text)

    @property
    def room(self) -> str:
        """The room that the file belongs to; empty for `models/__init__.py`."""
        top, _, inside = self.module.partition(".")
        return top if top == "runner" else inside.partition(".")[0]

    def imports(self) -> Iterator[str]:
        """The dotted names that the file imports anywhere, without `seatrial`."""
        is_package = self.file.endswith("__init__.py")
        package = self.module if is_package else self.module.rpartition(".")[0]
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                module = resolve_name("." * node.level + (node.module or ""), package)
                names = [f"{module}.{alias.name}" for alias in node.names]
            else:
                continue
            yield from (name.removeprefix("seatrial.") for name in names)

    def functions(self) -> Iterator[Function]:
        """Its functions and methods, inner ones too."""
        kernels = {
            argument.id
            for call in ast.walk(self.tree)
            if isinstance(call, ast.Call) and _name(call.func) in COMPILERS
            for argument in call.args
            if isinstance(argument, ast.Name)
        }
        for node in ast.walk(self.tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                given = node.args
                names = [a.arg for a in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
                count = len([name for name in names if name not in ("self", "cls")])
                count += (given.vararg is not None) + (given.kwarg is not None)
                compiled = any(_name(one) in COMPILERS for one in node.decorator_list)
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                is_kernel = compiled or node.name in kernels
                yield Function(self.file, node.name, lines, count, is_kernel)


def _name(node: ast.expr) -> str:
    node = node.func if isinstance(node, ast.Call) else node
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


class House:
    """The sources of a checkout and what is counted of them."""

    def __init__(self, checkout: Path = ROOT) -> None:
        paths = sorted([*checkout.glob("models/**/*.py"), *checkout.glob("runner/**/*.py")])
        self.sources: dict[str, Source] = {}
        for path in paths:
            file = path.relative_to(checkout).as_posix()
            module = file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
            self.sources[module] = Source(file, module, path.read_text(encoding="utf-8"))
        self.functions = [one for source in self.sources.values() for one in source.functions()]

    @cached_property
    def files(self) -> Mapping[str, set[str]]:
        """The modules that each module imports."""
        return {
            module: {self._module(name) for name in source.imports()} - {"", module}
            for module, source in self.sources.items()
        }

    @cached_property
    def rooms(self) -> Mapping[str, set[str]]:
        """The rooms that each room imports."""
        rooms: dict[str, set[str]] = {s.room: set() for s in self.sources.values() if s.room}
        for module, others in self.files.items():
            room = self.sources[module].room
            if room:
                rooms[room] |= {self.sources[other].room for other in others} - {"", room}
        return rooms

    def _module(self, name: str) -> str:
        """The module that an imported name is, or is in; empty for another package's."""
        while name and name not in self.sources:
            name = name.rpartition(".")[0]
        return name

    def floors(self) -> int:
        """How many rooms the longest chain of imports has; rooms in a circle do not count."""
        rest, count = dict(self.rooms), 0
        while ground := {room for room, others in rest.items() if not others & rest.keys()}:
            rest = {room: others for room, others in rest.items() if room not in ground}
            count += 1
        return count

    def circles(self) -> list[list[str]]:
        """The groups of modules that import each other."""
        reach = {module: set(others) for module, others in self.files.items()}
        for between in reach:
            for others in reach.values():
                if between in others:
                    others |= reach[between]
        groups = {
            frozenset(other for other in others if module in reach[other])
            for module, others in reach.items()
            if module in others
        }
        return sorted(sorted(group) for group in groups)

    def too_many_arguments(self) -> list[Function]:
        """Functions with more arguments than a reader keeps apart; kernels take plain arrays."""
        return [f for f in self.functions if f.arguments > MOST_ARGUMENTS and not f.is_kernel]

    def too_long(self) -> list[Function]:
        """Functions that are no longer read at a glance."""
        return [f for f in self.functions if f.lines > MOST_LINES]

    def uses_of_any(self) -> int:
        """How often `Any` stands in the code, imports not counted."""
        nodes = (node for source in self.sources.values() for node in ast.walk(source.tree))
        return sum(isinstance(node, ast.Name) and node.id == "Any" for node in nodes)

    def imports_in_functions(self) -> int:
        """How many import statements stand inside functions."""
        return sum(
            len(
                {
                    inner
                    for node in ast.walk(source.tree)
                    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
                    for inner in ast.walk(node)
                    if isinstance(inner, ast.Import | ast.ImportFrom)
                }
            )
            for source in self.sources.values()
        )

    def shared_names(self) -> list[str]:
        """The names that more than one file has."""
        stems = Counter(Path(s.file).stem for s in self.sources.values())
        return sorted(n for n, count in stems.items() if count > 1 and not n.startswith("__"))

    def figures(self) -> dict[str, int]:
        """What is counted, in words, and how much of it there is."""
        sources = self.sources.values()
        lengths = [function.lines for function in self.functions]
        return {
            "rooms": len(self.rooms),
            "floors": self.floors(),
            "arrows between rooms": sum(map(len, self.rooms.values())),
            "circles of files": len(self.circles()),
            "files, `__init__.py` not counted": sum("__init__" not in s.file for s in sources),
            "lines": sum(len(source.text.splitlines()) for source in sources),
            "lines of a function, median": round(median(lengths)),
            "lines of the longest function": max(lengths),
            f"functions over {MOST_LINES} lines": len(self.too_long()),
            f"functions with more than {MOST_ARGUMENTS} arguments, kernels not counted": len(
                self.too_many_arguments()
            ),
            "`Any`": self.uses_of_any(),
            "imports inside functions": self.imports_in_functions(),
            "`# fmt: skip`": sum(source.text.count("# fmt: skip") for source in sources),
            "names that several files have": len(self.shared_names()),
        }


def table(figures: Mapping[str, int]) -> str:
    """The figures beside those of the commit before, in Markdown."""
    rows = [f"| `models/` and `runner/` | {BEFORE} | now |", "|---|---:|---:|"]
    for (name, now), before in zip(figures.items(), BEFORE_FIGURES, strict=True):
        rows.append(f"| {name} | {before:,} | {now:,} |")
    return "\n".join(rows)


if __name__ == "__main__":
    house = House(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT)
    print(table(house.figures()))
    for circle in house.circles():
        print(f"circle: {', '.join(circle)}", file=sys.stderr)
    for function in dict.fromkeys((*house.too_long(), *house.too_many_arguments())):
        print(function, file=sys.stderr)
