"""Provenance of results: sources, package versions, machine and command line."""

import os
import platform
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from seatrial.runner.configuration.fingerprint import source_digest
from seatrial.runner.configuration.invocation import ROOT, in_checkout, typed_command

# The packages that results can depend on.
PACKAGES = (
    *("seatrial", "numpy", "scipy", "numba", "llvmlite", "scikit-learn", "pymoo", "daqp"),
    *("hydra-core", "omegaconf", "sqlalchemy", "pyarrow"),
)


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
    """Collect the provenance of this process."""
    changes = _git("status", "--porcelain", "--untracked-files=no")
    machine = {"python": platform.python_version(), "platform": platform.platform()}
    versions = {**machine, "cpus": str(os.cpu_count())}
    for name in PACKAGES:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    return Provenance(
        git_commit=_git("rev-parse", "HEAD"),
        git_dirty=None if changes is None else changes != "",
        versions=versions,
        command=typed_command(sys.orig_argv),
        sources=source_digest(),
    )


def _git(*arguments: str) -> str | None:
    """Run git in the checkout and return its output; None without git or without a checkout.

    An installed package may be inside the repository of another project, so git is not run for it.
    """
    if not in_checkout(ROOT):
        return None
    command = ["git", "-C", str(ROOT), *arguments]
    quiet = subprocess.DEVNULL
    try:
        return subprocess.check_output(command, stderr=quiet, text=True, timeout=10).strip()
    except (OSError, subprocess.SubprocessError):
        return None
