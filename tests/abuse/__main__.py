"""`python -m tests.abuse`: hostile use of the programs, within a time that is bounded.

It ends with a table of what was tried, what held and what did not; exit code 1 if anything did not.
"""

import argparse
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.abuse import ledger
from tests.abuse.ledger import Entry

SEED = 20260201


def main() -> int:
    """Try what was asked for, print the table and write the file."""
    options = _options()
    print(f"seed {options.seed}", flush=True)
    entries: list[Entry] = []
    began = time.monotonic()
    for name, task in _tasks(options).items():
        if options.what and name not in options.what:
            continue
        with _folder(name) as folder:
            since = time.monotonic()
            entry = task(folder)
        entry.seconds = time.monotonic() - since
        entries.append(entry)
        print(f"{name}: {entry.tried} tried in {entry.seconds:.0f} s, {len(entry.violations)} violated", flush=True)
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
    parser.add_argument("--quick", action="store_true", help="a part of it, about a minute")
    parser.add_argument("--output", type=Path, default=Path("results/abuse.json"))
    return parser.parse_args()


def _tasks(options: argparse.Namespace) -> dict[str, Callable[[Path], Entry]]:
    from tests.abuse import isolated
    from tests.abuse.malformed import KINDS, malformed

    isolated.preload()
    share = 0.1 if options.quick else 1.0
    tasks: dict[str, Callable[[Path], Entry]] = {}
    for kind in KINDS:
        tasks[kind] = lambda folder, kind=kind: malformed(  # type: ignore[misc]
            kind, folder, options.seed, share, options.case
        )
    return tasks


@contextmanager
def _folder(name: str) -> Iterator[Path]:
    folder = Path(tempfile.mkdtemp(prefix=f"seatrial-abuse-{name}-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    sys.exit(main())
