"""Plans of trials: each is built, checked and given its fingerprint before a sweep starts.

The trials of a sweep differ in a few options. What is computed from a part of the configuration
that does not differ is computed once: the objects, the checks of the trial, the fingerprint's text.
"""

from pathlib import Path
from sys import intern
from typing import cast

from seatrial.models.errors import SeatrialError
from seatrial.runner.config import Trial, build_trial
from seatrial.runner.fingerprint import fingerprint
from seatrial.runner.job import Order, Plan
from seatrial.runner.plugins import attributed
from seatrial.runner.precompile import kinds
from seatrial.runner.shared import SharedNodes

Outcome = tuple[dict[str, object], SeatrialError | None]  # what a check has read, its error


class Planner:
    """Plans the trials of one sweep; `sources` is the digest of the code that computes results."""

    def __init__(self, sources: str) -> None:
        self._sources = sources
        self._nodes = SharedNodes()
        self._check = Checks()
        self._folders: dict[Path, Path] = {}  # one object for equal folders

    def plan(self, order: Order) -> Plan:
        """Build and check a trial; raises SeatrialError if it cannot be run."""
        config = self._nodes.of(order.config)
        trial = build_trial(config, order.names)
        self._check(trial)
        return Plan(
            overrides=order.overrides,
            fingerprint=fingerprint(config, order.names, self._sources),
            database_url=intern(trial.database_url),
            results_dir=self._folders.setdefault(trial.results_dir, trial.results_dir),
            rerun=trial.rerun,
            labels=trial.sweep,
            kinds=tuple(map(intern, kinds(trial))),
        )


class Checks:
    """The checks of trials; they are repeated only if something they read is different.

    A check is a function of the attributes that it reads: a trial that is equal in all of them has
    the same outcome.
    """

    KEPT = 1024  # largest number of outcomes; the oldest is dropped

    def __init__(self) -> None:
        self._outcomes: dict[tuple[object, ...], Outcome] = {}
        self._read: dict[tuple[str, ...], None] = {}  # the sets of attributes that checks have read

    def __call__(self, trial: Trial) -> None:
        """Check a trial; raises SeatrialError if it cannot be run."""
        _, error = self._known(trial) or self._checked(trial)
        if error is not None:
            raise error.with_traceback(None)

    def _known(self, trial: Trial) -> Outcome | None:
        keys = (_key({name: getattr(trial, name) for name in names}) for names in self._read)
        return next((self._outcomes[key] for key in keys if key in self._outcomes), None)

    def _checked(self, trial: Trial) -> Outcome:
        from seatrial.runner import trial as trials

        reads, error = _Reads(trial), None
        try:
            with attributed(trial.config):
                trials.check(cast(Trial, reads))
        except SeatrialError as problem:
            error = problem
        if len(self._outcomes) >= self.KEPT:
            del self._outcomes[next(iter(self._outcomes))]
        self._read[tuple(reads.values)] = None
        outcome = self._outcomes[_key(reads.values)] = reads.values, error
        return outcome


class _Reads:
    """A trial that notes which of its attributes are read."""

    def __init__(self, trial: Trial) -> None:
        self._trial = trial
        self.values: dict[str, object] = {}

    def __getattr__(self, name: str) -> object:
        value = self.values[name] = getattr(self._trial, name)
        return value


def _key(values: dict[str, object]) -> tuple[object, ...]:
    """Return equal keys for equal numbers and texts, and for the same objects."""
    plain = (bool, int, float, str, type(None))
    return tuple(
        (name, repr(value) if isinstance(value, plain) else id(value))
        for name, value in values.items()
    )
