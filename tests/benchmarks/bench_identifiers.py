"""Identifiers on recordings of 10^3 to 10^6 samples: time, peak memory, and their growth.

The ferry on its laps with PRBS and noise at 0.1 s; each identifier and size in a process of its
own (`identify`), as configured unless a row says otherwise. One that would take longer than a
minute at the next size, if it grew in proportion, is not given it. About 6 minutes.
"""

import json
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.benchmarks.conftest import growth
from tests.benchmarks.identify import write

SIZES = [10**3, 10**4, 10**5, 10**6]
LONG_S = 60.0
TIMEOUT_S = 900.0
LINEAR = 1.1  # slope asked of those that must be linear
MUST = ("ls", "ridge", "iv", "plsr", "surface_plsr", "dsr")
OPTIONS = {
    "plsr, no errors": ("identifier.bootstrap=null",),
    "dsr": ("identifier.bootstrap=null", "identifier.force=filtered"),
    "dsr with errors": ("identifier.force=filtered",),
}
LABELS = (  # an identifier's name, and what is said of its options
    "ls", "ridge", "iv", "plsr", "plsr, no errors", "surface_plsr", "dsr", "dsr with errors",
    "auto", "output_error", "nsga2",
)  # fmt: skip
ALL = (*MUST, "plsr, no errors")  # to the last size, however long


def child(file: Path, label: str) -> dict[str, Any]:
    """What a process says of an identifier on a recording."""
    name, overrides = re.split(r"\W", label)[0], OPTIONS.get(label, ())
    command = [sys.executable, "-m", "tests.benchmarks.identify", str(file), name, *overrides]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, timeout=TIMEOUT_S
        )
    except subprocess.TimeoutExpired:
        return {"error": f"longer than {TIMEOUT_S:.0f} s"}
    if done.returncode:
        return {"error": done.stderr.strip().splitlines()[-1]}
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


@cache
def recordings(folder: Path) -> dict[int, Path]:
    return write(folder, SIZES)


def curve(label: str, files: dict[int, Path]) -> dict[str, Any]:
    """Growth of one identifier, to the last size that it reaches."""
    sizes: list[int] = []
    times: list[float] = []
    peaks: list[float] = []
    why = ""
    for size, file in files.items():
        if label not in ALL and times and times[-1] * size / sizes[-1] > LONG_S:
            why = f"stopped: {size:,} would take more than {LONG_S:.0f} s"
            break
        found = child(file, label)
        if "error" in found:
            why = f"{size:,} samples: {found['error']}"
            if label in ALL or sizes:
                break
            continue
        sizes.append(size)
        times.append(found["seconds"])
        peaks.append(found["megabytes"])
    if len(sizes) < 2:
        only = f"{times[0]:.3g} s, {peaks[0]:.0f} MB at {sizes[0]:,}" if sizes else "none"
        return {"shown": "; ".join(filter(None, [only, why]))}
    found = growth(sizes, times, peaks, of="samples")
    found["shown"] += f"; at the last {times[-1]:.3g} s, {peaks[-1]:,.0f} MB"
    found["shown"] += f"; {why}" if why else ""
    if label in MUST:
        found["limit"] = f"slope at most {LINEAR}, to {SIZES[-1]:,}"
        if found["slope"] > LINEAR or sizes[-1] < SIZES[-1]:
            found["short"] = f"slope {found['slope']:.2f}, to {sizes[-1]:,}"
    return found


def test_identifiers(stated: Any, tmp_path_factory: pytest.TempPathFactory) -> None:
    files = recordings(tmp_path_factory.mktemp("recordings"))
    stated(
        lambda: {label: curve(label, files) for label in LABELS},
        item="7b", what="identification",
        note="memory is the peak of the whole process, about 225 MB before it reads anything; dsr "
        "on the filtered force; errors are standard errors by bootstrap",
    )  # fmt: skip
