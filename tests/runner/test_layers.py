"""Imports point down: models <- runner.trial <- runner <- the command lines."""

import ast
from collections.abc import Iterator
from importlib.util import resolve_name
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = sorted([*(ROOT / "models").rglob("*.py"), *(ROOT / "runner").rglob("*.py")])
# Where Hydra ends: everything else takes plain values and checked objects.
EDGE = {
    "runner.__main__",
    "runner.sweep",
    "runner.launching",
    "runner.composition",
    "runner.complaints",
    "runner.variation",
}
SIBLINGS = ("excitation", "identification", "control")


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(path: Path) -> Iterator[str]:
    """Every module a file imports, anywhere in it, and every name it takes from one."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = module_of(path.parent / "__init__.py")
            module = resolve_name("." * node.level + (node.module or ""), package)
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def inside(name: str, *packages: str) -> bool:
    return any(name == package or name.startswith(f"{package}.") for package in packages)


def forbidden(module: str) -> tuple[str, ...]:
    """What a module must not import."""
    packages: list[str] = []
    if inside(module, "models"):
        packages += ["runner", "sqlalchemy", "alembic", "matplotlib", "rich", "typer", "jinja2"]
    if inside(module, "models.planning"):
        packages += [f"models.{name}" for name in SIBLINGS]
    if inside(module, *(f"models.{name}" for name in SIBLINGS)):
        own = module.split(".")[1]
        packages += [f"models.{name}" for name in SIBLINGS if name != own]
    if module not in EDGE:
        packages += ["hydra", "omegaconf"]
        if not inside(module, "runner.compare"):
            packages += ["runner.__main__", "runner.sweep", "runner.complaints"]
    if inside(module, "runner.compare"):
        packages += ["models", "runner.trial", "runner.sweep", "runner.config"]
    if inside(module, "runner.database"):
        packages += ["models", "runner.compare", "runner.trial", "runner.config", "matplotlib"]
    if not inside(module, "runner.compare"):
        packages += ["runner.compare"]
    return tuple(packages)


ALLOWED = {"models.errors"}  # one small tree of errors for everybody


@pytest.mark.parametrize("path", SOURCES, ids=module_of)
def test_imports_point_down(path: Path) -> None:
    module = module_of(path)
    for name in imports(path):
        if inside(name, *ALLOWED) or (name == "models" and module.startswith("runner")):
            continue
        assert not inside(name, *forbidden(module)), f"{module} imports {name}"


def test_the_rules_see_a_breach() -> None:
    assert inside("runner.trial", *forbidden("models.vessel"))
    assert inside("hydra.utils", *forbidden("runner.trial"))
    assert inside("models.control.pid", *forbidden("models.excitation.mission"))
    assert inside("models.vessel", *forbidden("runner.compare.table"))
    assert not inside("models.vessel", *forbidden("runner.trial"))
    assert len(SOURCES) > 30
