"""`python -m tests.abuse`: hostile use of the programs, within a time that is bounded.

It ends with a table of what was tried, what held and what did not; exit code 1 if anything did not.
"""

import argparse
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from tests.abuse import isolated, ledger
from tests.abuse.crowd import crowd, outage, suspended
from tests.abuse.disks import disks
from tests.abuse.guard import guarded
from tests.abuse.ledger import Entry
from tests.abuse.malformed import KINDS, malformed
from tests.abuse.storm import storm

SEED = 20260201
PROCESSES = (storm, crowd, outage, suspended, disks)


def main() -> int:
    """Try what was asked for, print the table and write the file."""
    options = _options()
    print(f"seed {options.seed}", flush=True)
    with guarded() as place:
        return _try(options, place)


def _try(options: argparse.Namespace, place: Path) -> int:
    entries: list[Entry] = []
    began = time.monotonic()
    for name, task in _tasks(options).items():
        if options.what and name not in options.what:
            continue
        folder = place / name
        folder.mkdir()
        folder.chmod(0o711)
        since = time.monotonic()
        new = task(folder)
        entries += new
        tried, violated = (
            sum(n) for n in zip(*((e.tried, len(e.violations)) for e in new), strict=True)
        )
        print(
            f"{name}: {tried} tried in {time.monotonic() - since:.0f} s, {violated} violated",
            flush=True,
        )
    print(f"\n{ledger.table(entries)}\n\n{time.monotonic() - began:.0f} s")
    for entry in entries:
        for remark in entry.remarks:
            print(f"remark: {entry.what}: {remark}")
    ledger.write(entries, options.seed, options.output)
    return int(any(entry.violations for entry in entries))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.abuse", description=__doc__)
    parser.add_argument("what", nargs="*", help="only these kinds")
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--case", type=int, nargs="*", default=[], help="only these inputs")
    parser.add_argument("--quick", action="store_true", help="a part of it")
    parser.add_argument("--output", type=Path, default=Path("results/abuse.json"))
    return parser.parse_args()


def _tasks(options: argparse.Namespace) -> dict[str, Callable[[Path], list[Entry]]]:
    isolated.preload()
    share = 0.06 if options.quick else 1.0
    tasks: dict[str, Callable[[Path], list[Entry]]] = {}
    for kind in KINDS:
        tasks[kind] = partial(_malformed, kind=kind, options=options, share=share)
    # make slow tries crowds and a server that leaves elsewhere.
    tries = (storm, suspended, disks) if options.quick else PROCESSES
    for task in tries:
        tasks[task.__name__] = partial(task, seed=options.seed, share=share)
    return tasks


def _malformed(folder: Path, kind: str, options: argparse.Namespace, share: float) -> list[Entry]:
    return [malformed(kind, folder, options.seed, share, options.case)]


if __name__ == "__main__":
    sys.exit(main())
