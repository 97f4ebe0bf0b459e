"""Compilation before a sweep starts its workers, so that they do not all compile the same code.

What a trial compiles depends on the kinds of its parts: their classes and choices, not their
numbers. Of each combination of kinds one trial is run in this process, on few samples and without
storing anything. An empty file beside the machine code notes that this has been done.
"""

import logging
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, is_dataclass, replace
from hashlib import sha256
from typing import TYPE_CHECKING

from seatrial.runner.configuration.config import Trial
from seatrial.runner.configuration.plugins import targets
from seatrial.runner.record.vocabulary import GROUPS

if TYPE_CHECKING:  # what is slow to import
    import threadpoolctl

    from seatrial.models import compiled
    from seatrial.models.excitation import missions
    from seatrial.runner.trials import trial as trials
else:
    import lazy_loader

    compiled = lazy_loader.load("seatrial.models.compiled", suppress_warning=True)
    missions = lazy_loader.load("seatrial.models.excitation.missions", suppress_warning=True)
    threadpoolctl = lazy_loader.load("threadpoolctl")
    trials = lazy_loader.load("seatrial.runner.trials.trial", suppress_warning=True)

OWN = "seatrial.models."  # parts from elsewhere and other programs are run by workers only
SAMPLES = 2000  # of each recording, enough for every identifier
# What a simulation or an identification is compiled for; loops are not for what they call.
TOGETHER = (
    *(("vessel", "disturbance"), ("vessel", "excitation"), ("vessel", "evaluation")),
    ("vessel", "identifier", "controller"),
)


def kinds(trial: Trial) -> tuple[str, ...]:
    """Return digests of the kinds of parts that a trial combines; none for parts from elsewhere."""
    if not all(name.startswith(OWN) for name in targets(trial.config)):
        return ()
    parts = {group: _kind(getattr(trial, group)) for group in GROUPS}
    excitation, simulated = trial.excitation, False
    if isinstance(excitation, missions.Mission):
        simulated = True
        if trial.evaluation is not None:  # a replay sails the excitation
            parts["evaluation"] = _kind(trial.evaluation.mission(excitation))
    rest = simulated, _kind(trial.update), _kind(trial.plant.change)
    rows = [(rest, *(parts[group] for group in groups)) for groups in TOGETHER]
    return tuple(sha256(repr(row).encode()).hexdigest()[:16] for row in rows)


def _kind(value: object) -> object:
    """Describe a part by classes, choices and types; numbers, names and paths do not count."""
    if is_dataclass(value):
        named = {f.name: getattr(value, f.name) for f in fields(value) if f.name != "name"}
        return type(value).__qualname__, *map(_kind, named.values())
    if isinstance(value, Mapping):
        return tuple(map(_kind, value.values()))
    if isinstance(value, list | tuple):
        return sorted({repr(_kind(item)) for item in value})
    is_choice = value is None or isinstance(value, bool) or str(value).isidentifier()
    return value if is_choice else type(value).__name__


def precompile(planned: Iterable[tuple[Sequence[str], Callable[[], Trial]]]) -> None:
    """Compile what trials need, unless it has been compiled on this machine before.

    Args:
        planned: the kinds of each trial, and a function that makes the trial.
    """
    folder = compiled.cache_folder()
    known = {path.stem for path in folder.glob("*.kind")}
    for names, make in planned:
        if not known.issuperset(names):
            # A trial that fails here fails in a worker as well, which stores its error.
            with suppress(Exception), _quiet(), threadpoolctl.threadpool_limits(1):
                trials.run(replace(make(), samples=SAMPLES))
            with suppress(OSError):
                for name in names:
                    (folder / f"{name}.kind").touch()
            known.update(names)


@contextmanager
def _quiet() -> Iterator[None]:
    """Show of the log only that code is being compiled."""
    loggers = logging.getLogger(OWN.partition(".")[0]), compiled.log
    before = [logger.level for logger in loggers]
    for logger, level in zip(loggers, (logging.ERROR, logging.INFO), strict=True):
        logger.setLevel(level)
    try:
        with warnings.catch_warnings(action="ignore"):
            yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)
