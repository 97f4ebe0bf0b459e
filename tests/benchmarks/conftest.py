"""Benchmarks: what a user would pick instead, measured in turn with ours in the same run.

`make bench` runs the files `bench_*.py` here; `make test` does not see them. A benchmark never
fails for being slow: whether a result is right is for the tests to say, and what a ratio is, for
the table that `docs/benchmarks.py` makes of `results/bench.json`.
"""

import os
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

Work = Callable[[], object]
NO_REMARK = {"why": "", "note": ""}


def seconds(work: Work, calls: int = 1) -> float:
    """Wall-clock time of one of `calls` calls in a row [s]."""
    begun = time.perf_counter()
    for _ in range(calls):
        work()
    return (time.perf_counter() - begun) / calls


@pytest.fixture
def in_turn(benchmark: Any) -> Callable[..., None]:
    """Measures `ours` and `peer` turn by turn, so that other work on the machine meets both.

    Both are called once before, which compiles what is compiled; not so with `warm=False`, where
    the benchmark has called them to compare what they give. `calls` and `peer_calls` are how
    many calls in a row make one measurement, where one is too short for the clock. The rest is
    for the table: `item`, `what`, `name`, `peer_name`; `wanted` is the ratio of the medians, peer
    over ours, that it compares with, `why` explains there what falls short, `note` says in every
    case what a reader must know.
    """

    def measure(
        ours: Work, peer: Work, *, name: str, peer_name: str, rounds: int = 7, calls: int = 1,
        peer_calls: int = 1, warm: bool = True, **row: Any,
    ) -> None:  # fmt: skip
        if warm:
            ours()
            peer()
        peers: list[float] = []
        benchmark.pedantic(
            lambda: seconds(ours, calls),
            setup=lambda: peers.append(seconds(peer, peer_calls)),
            rounds=rounds,
        )
        measured = {"calls": calls, "peer_seconds": peers, "load": os.getloadavg()[0]}
        named = {"kind": "ratio", "ours": name, "peer": peer_name, "wanted": None}
        benchmark.extra_info.update(NO_REMARK | named | row | measured)

    return measure


@pytest.fixture
def stated(benchmark: Any) -> Callable[..., None]:
    """Keeps figures that are no ratio: `work` is run once and gives them by name.

    Each is a mapping with `shown`, the text of the table, `limit`, what was asked, where something
    was, and `short`, by how much it falls short, where it does; any other entry is kept in
    `results/bench.json`. Of `growth`, entries are size [-], seconds and MB.
    """

    def keep(work: Callable[[], dict[str, dict[str, Any]]], **row: str) -> None:
        measured = {"found": benchmark.pedantic(work, rounds=1), "load": os.getloadavg()[0]}
        benchmark.extra_info.update(NO_REMARK | {"kind": "figures"} | row | measured)

    return keep


def growth(
    sizes: list[int], times: list[float], peaks: list[float] | None = None, of: str = ""
) -> dict[str, Any]:
    """A curve of time [s] (and peak memory [MB]) over size, with its slope on logarithmic axes.

    `of` is what the size counts, for the axis of the figure: "samples of the recording".
    """
    slope = float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
    shown = f"slope {slope:.2f}, {sizes[0]:,} to {sizes[-1]:,} {of}".rstrip()
    return {
        "shown": shown, "slope": slope, "sizes": sizes, "seconds": times,
        "megabytes": peaks or [], "of": of,
    }  # fmt: skip
