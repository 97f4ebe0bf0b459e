"""Imports point down: a folder imports only what stands before it."""

import ast
import re
from collections.abc import Iterator
from functools import cache

from docs.house import ROOT, House, imports

# From the ground up; a file is on the floor of the longest name that it lies in.
FLOORS = (
    *("models.errors", "models.diagnostics", "models.returned", "models.ranges"),
    *("models.source_digest", "models.compiled", "models.bound", "models.elementary"),
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
    *("__main__", "sweep", "processes", "launching", "composition"),
    *("hydra_errors", "in_process", "yaml_files"),
    *("search", "search_path"),
}
FOREIGN_TO_MODELS = {"hydra", "omegaconf", "sqlalchemy", "matplotlib", "rich", "typer"}


@cache
def house() -> House:
    """The sources, read once."""
    return House()


def module_of(file: str) -> str:
    return file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def imported(file: str) -> Iterator[str]:
    """Every name that a file imports, anywhere in it, for type checks as well."""
    return imports(module_of(file), file.endswith("__init__.py"), house().trees[file])


def floor(name: str) -> str:
    return max((f for f in FLOORS if name == f or name.startswith(f"{f}.")), key=len, default="")


def refused(module: str, name: str) -> bool:
    """Whether a module must not import a name."""
    own, top = floor(module), name.partition(".")[0]
    if top not in ("models", "runner"):
        if module.startswith("models"):
            return top in FOREIGN_TO_MODELS
        edge = module.startswith("runner.") and module.split(".")[-1] in EDGE
        return top in ("hydra", "omegaconf") and not edge
    other = floor(name)
    if other in ("", own):
        return False
    return FLOORS.index(other) > FLOORS.index(own) or other not in ONLY.get(own, FLOORS)


def test_imports_point_down() -> None:
    assert len(house().trees) > 100
    breaches = [
        f"{file} imports {name}"
        for file in house().trees
        for name in imported(file)
        if refused(module_of(file), name)
    ]
    assert not breaches


def test_the_rules_see_a_breach() -> None:
    assert refused("models.vessel.table", "runner.trials.trial.run")
    assert refused("runner.trials.trial", "hydra.utils")
    assert refused("models.excitation.missions", "models.control.pid.Pid")
    assert refused("runner.compare.table", "models.vessel.table.Vessel")
    assert not refused("runner.trials.trial", "models.vessel.table.Vessel")


def test_private_parts_of_other_packages_are_listed_with_their_tests() -> None:
    listed = ast.get_docstring(house().trees["runner/__main__.py"]) or ""
    private = re.compile(r"hydra\._internal|submitit|joblib\.externals|loky")
    files = house().trees
    used = {
        name.rpartition(".")[2] for file in files for name in imported(file) if private.match(name)
    }
    texts = ((ROOT / file).read_text() for file in files)
    own = {name for text in texts for name in re.findall(r"(?<![.\w])_\w+", text)}
    attributes = set[str]()
    for file in (file for file in files if file.startswith("runner/")):
        for node in ast.walk(files[file]):
            if isinstance(node, ast.Attribute) and re.match("_[a-z]", node.attr):
                (own if isinstance(node.ctx, ast.Store) else attributes).add(node.attr)
    used |= attributes - own
    used -= {"_asdict", "_fields", "_replace", "_exit"}  # documented
    assert used == used & set(re.findall(r"\w+", listed)) != set()
    tests = re.findall(r"tests/\S+\.py", listed)
    assert all((ROOT / test).is_file() for test in tests)
