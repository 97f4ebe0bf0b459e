"""Imports point down: a folder imports only what stands before it."""

import ast
import re
from collections.abc import Iterator
from importlib.util import resolve_name
from pathlib import Path

ROOT = Path(__file__).parents[2]
SOURCES = sorted([*(ROOT / "models").rglob("*.py"), *(ROOT / "runner").rglob("*.py")])
# From the ground up; a file is on the floor of the longest name that it lies in.
FLOORS = (
    *("models.errors", "models.diagnostics", "models.returned", "models.ranges"),
    *("models.source_digest", "models.compiled", "models.elementary"),
    *("models.packs", "models.symbols"),
    *("models.notation", "models.vessel", "models.recording", "models.planning"),
    *("models.weather", "models.simulation", "models.excitation", "models.identification"),
    *("models.control", "runner.record", "runner.database", "runner.configuration"),
    *("runner.export", "runner.compare", "runner.trials", "runner.sweeps"),
    *("runner.interface", "runner.commands", "runner"),
)
# The comparison reads the database, and the tasks of the benchmark, alone; the database holds rows,
# whatever they mean.
GROUND = ("models.errors", "models.notation", "models.diagnostics", "runner.record")
ONLY = {
    "runner.database": GROUND,
    "runner.compare": (*GROUND, "runner.configuration", "runner.database", "runner.export"),
}
# Where Hydra ends: everything else takes plain values and checked objects.
EDGE = {
    *("__main__", "sweep", "processes", "launching", "composition", "overrides"),
    *("hydra_errors", "in_process", "yaml_files"),
    *("search", "search_path"),
}
FOREIGN_TO_MODELS = {"hydra", "omegaconf", "sqlalchemy", "matplotlib", "rich", "typer"}


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> Iterator[str]:
    """Every module a file imports, anywhere in it, for type checks as well."""
    package = "seatrial." + module_of(path.parent / "__init__.py")
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            module = resolve_name("." * node.level + (node.module or ""), package)
            yield from (f"{module}.{alias.name}" for alias in node.names)


def floor(name: str) -> str:
    return max((f for f in FLOORS if name == f or name.startswith(f"{f}.")), key=len, default="")


def refused(module: str, name: str) -> bool:
    """Whether a module must not import a name."""
    own, top = floor(module), name.partition(".")[0]
    if top != "seatrial":
        if module.startswith("models"):
            return top in FOREIGN_TO_MODELS
        edge = module.startswith("runner.") and module.split(".")[-1] in EDGE
        return top in ("hydra", "omegaconf") and not edge
    other = floor(name.removeprefix("seatrial."))
    if other in ("", own):
        return False
    return FLOORS.index(other) > FLOORS.index(own) or other not in ONLY.get(own, FLOORS)


def test_imports_point_down() -> None:
    breaches = [
        f"{module_of(path)} imports {name}"
        for path in SOURCES
        for name in imports(path)
        if refused(module_of(path), name)
    ]
    assert not breaches


def test_the_rules_see_a_breach() -> None:
    assert refused("models.vessel.table", "seatrial.runner.trials.trial.run")
    assert refused("runner.trials.trial", "hydra.utils")
    assert refused("models.excitation.missions", "seatrial.models.control.pid.Pid")
    assert refused("runner.compare.table", "seatrial.models.vessel.table.Vessel")
    assert not refused("runner.trials.trial", "seatrial.models.vessel.table.Vessel")
    assert len(SOURCES) > 100


def test_private_parts_of_other_packages_are_listed_with_their_tests() -> None:
    listed = ast.get_docstring(ast.parse((ROOT / "runner" / "__main__.py").read_text())) or ""
    private = re.compile(r"hydra\._internal|submitit|joblib\.externals|loky")
    used = {
        name.rpartition(".")[2] for path in SOURCES for name in imports(path) if private.match(name)
    }
    own = {name for path in SOURCES for name in re.findall(r"(?<![.\w])_\w+", path.read_text())}
    attributes = set[str]()
    for path in (ROOT / "runner").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute) and re.match("_[a-z]", node.attr):
                (own if isinstance(node.ctx, ast.Store) else attributes).add(node.attr)
    used |= attributes - own
    used -= {"_asdict", "_replace", "_exit"}  # documented
    assert used == used & set(re.findall(r"\w+", listed)) != set()
    tests = re.findall(r"tests/\S+\.py", listed)
    assert all((ROOT / test).is_file() for test in tests)
