"""The closed loop of the milliAmpere, 24 minutes; as a program, with the compiler disabled.

`python -m tests.benchmarks.uncompiled` sails once for every line of its input, and answers with
the log of the voyage: a process that is kept alive, so that neither its start nor its imports are
measured.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

from seatrial.models.simulation.voyage import Log
from seatrial.runner.trials.closed_loop import Streams, prepare
from tests.trials import composed


def closed_loop() -> Callable[[], Log]:
    """Sails twelve way-points, 120 s each: 14,400 control instants of four steps by RK4."""
    trial = composed("excitation.interval_s=120", "identifier=none", "evaluation=none")
    ready = prepare(trial, Streams(trial.seed), trial.vessel.nominal(), trial.excitation)

    def sailed() -> Log:
        control, guidance = deepcopy((ready.control, ready.guidance))  # their states are written
        return replace(ready, control=control, guidance=guidance).sail().voyage.log

    return sailed


@contextmanager
def interpreter() -> Iterator[Callable[[], Log]]:
    """The same in another process without a compiler, alive as long as the context."""
    with subprocess.Popen(
        [sys.executable, "-m", __name__], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, cwd=Path(__file__).parents[2],
    ) as child:  # fmt: skip # which ends with its input
        assert child.stdin is not None
        assert child.stdout is not None
        ask, answer = child.stdin, child.stdout

        def sailed() -> Log:
            ask.write(b"\n")
            ask.flush()
            found: Log = pickle.load(answer)
            return found

        yield sailed


def main() -> None:
    """Sail once a line."""
    sailed = closed_loop()
    for _ in sys.stdin:
        pickle.dump(sailed(), sys.stdout.buffer)
        sys.stdout.buffer.flush()


if __name__ == "__main__":
    main()
