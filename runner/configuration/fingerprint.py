"""Fingerprints of trials, and where results come from.

Fingerprints are equal for equal configurations and equal code that computes the results. That code
is all of `models/`, the modules of this package that `trial.py` imports, except the storage, and
the files of user-defined parts. Comments and docstrings do not count.
"""

import hashlib
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from seatrial.models.errors import ConfigurationError
from seatrial.models.source_digest import MODELS_FOLDER, files_digest, folder_digest, imported_files
from seatrial.runner.configuration.invocation import ROOT, in_checkout, typed_command
from seatrial.runner.configuration.plugins import is_own, targets
from seatrial.runner.configuration.search_path import harbour_file, located
from seatrial.runner.record.vocabulary import NOT_COMPARED

if TYPE_CHECKING:  # what is slow to import
    from seatrial.models.recording import recorded_file as files
else:
    import lazy_loader

    files = lazy_loader.load("seatrial.models.recording.recorded_file", suppress_warning=True)

RUNNER = Path(__file__).parents[1]
PACKAGE = __name__.rsplit(".", 2)[0]  # of the runner
# The second is named by a configuration alone.
COMPUTING = ("trials/trial.py", "trials/command_identifier.py")
STORAGE = ("database", "compare")  # subpackages that store and show what was computed
INSTALLED = ("site-packages", "dist-packages")  # folders of installed packages
FILE_NAME = re.compile(r"[./]")  # that the name of a file has, beside a folder or suffix
# Options that name files, also those that come with the project: maps of recordings, harbours.
NAMED: Mapping[str, Callable[[str], Path]] = {
    "path": Path, "train": Path, "test": Path, "file": Path,
    "map": located, "test_map": located, "harbour": harbour_file,
}  # fmt: skip
# The packages that results can depend on.
PACKAGES = (
    *("seatrial", "numpy", "scipy", "numba", "llvmlite", "scikit-learn", "pymoo", "daqp"),
    *("hydra-core", "omegaconf", "sqlalchemy", "pyarrow"),
)
GIT = ("git", "-C", str(ROOT), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
EXACT_INTEGERS = 2**53  # up to here a float holds every integer


def fingerprint(config: Mapping[str, object], names: Mapping[str, str], sources: str) -> str:
    """Return the SHA-256 of a resolved configuration, its option names and a digest of sources.

    The order of keys does not matter, and 1 equals 1.0. User-defined parts count with their files.
    """
    compared = {str(key): node for key, node in config.items() if key not in NOT_COMPARED}
    compared.setdefault("excitation", None)
    nodes = {key: _by_files(key, node) for key, node in compared.items()}
    chosen = {group: name for group, name in names.items() if group not in NOT_COMPARED}
    parts = {name: part_digest(name) for name in targets(nodes) if not is_own(name)}
    content = canonical({"config": nodes, "names": chosen, "parts": parts, "sources": sources})
    return hashlib.sha256(content.encode()).hexdigest()


def _by_files(key: str, node: object) -> object:
    """Replace the files that options name, or match, by the digests of their content."""
    if isinstance(node, Mapping):
        if key == "excitation" and isinstance(node.get("train"), list | tuple) and node["train"]:
            with suppress(ConfigurationError):  # which the trial says
                sets = (node["train"], node.get("test") or ())
                train, test = ([*map(str, files.matched(names))] for names in sets)
                node = {**node, "train": train, "test": test}
        return {str(name): _by_files(str(name), value) for name, value in node.items()}
    if isinstance(node, list | tuple):
        return [_by_files(key, value) for value in node]
    if not isinstance(node, str) or not (key in NAMED or FILE_NAME.search(node)):
        return node
    try:
        path = NAMED.get(key, Path)(node).expanduser()
        if path.is_dir() and key == "path":
            return [_digest(file) for file in sorted(path.rglob("*")) if file.is_file()]
        return _digest(path) if path.is_file() else node
    except (OSError, ValueError):  # a text that is no path
        return node


def _digest(path: Path) -> str:
    stat = path.stat()
    return _file_digest(str(path), stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=4096)
def _file_digest(path: str, _changed_ns: int, _size: int) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def canonical(value: object) -> str:
    """Return JSON text that is equal for equal values; raises ValueError for NaN and infinity."""
    return json.dumps(
        _plain(value), sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
    )


def source_digest(models_folder: Path = MODELS_FOLDER, runner_folder: Path = RUNNER) -> str:
    """Return the SHA-256 of the syntax trees of the project's code that computes results."""
    runner_files = {
        path
        for name in COMPUTING
        for path in imported_files(runner_folder / name, runner_folder, PACKAGE, STORAGE)
    }
    digests = (folder_digest(models_folder), files_digest(runner_folder, runner_files))
    return hashlib.sha256("".join(digests).encode()).hexdigest()


def part_digest(target: str) -> str:
    """Return the SHA-256 of the file that defines `module.Class`, and of its imports.

    Imports from the package of the file count; those of a module without a package count if they
    are in its folder, unless that is one of installed packages.
    """
    module_name, _, class_name = target.rpartition(".")
    module = import_module(getattr(import_module(module_name), class_name).__module__)
    file, package = Path(str(module.__file__)), module.__package__
    alone = not package and file.parent.name in INSTALLED
    files = {file} if alone else imported_files(file, file.parent, package or "")
    return files_digest(file.parent, files)


def _plain(value: object) -> object:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and value.is_integer() and abs(value) <= EXACT_INTEGERS:
        return int(value)
    return value


@dataclass(frozen=True)
class Provenance:
    """The provenance of results, collected once per command and passed to the workers."""

    git_commit: str | None
    git_dirty: bool | None
    versions: dict[str, str]  # of packages; with python, platform and the number of cpus
    command: str  # as typed
    sources: str  # digest of the code that computes results


@cache
def collect() -> Provenance:
    """Collect the provenance of this process.

    An installed package may be inside the repository of another project, so git is not run for it.
    """
    machine = {"python": platform.python_version(), "platform": platform.platform()}
    versions = {**machine, "cpus": str(os.cpu_count())}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    commit = ""
    if in_checkout(ROOT):
        with suppress(OSError, subprocess.SubprocessError):
            quiet = subprocess.DEVNULL
            commit = subprocess.check_output(GIT, stderr=quiet, text=True, timeout=10).strip()
    return Provenance(
        git_commit=commit.removesuffix("-dirty") or None,
        git_dirty=commit.endswith("-dirty") if commit else None,
        versions=versions,
        command=typed_command(sys.orig_argv),
        sources=source_digest(),
    )
