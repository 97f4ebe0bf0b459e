"""Trials that are ready to run, those that cannot be, and what the logbook knows of them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from runner.config import Trial
from runner.job import Order

if TYPE_CHECKING:
    from runner.database.records import RunSummary


@dataclass(frozen=True)
class Plan:
    """A trial that passed every check, the order it came from, and its fingerprint."""

    trial: Trial
    order: Order
    fingerprint: str


@dataclass(frozen=True)
class Refusal:
    """A trial that cannot be run: what was asked for, and why not."""

    asked: str
    reason: str

    def __str__(self) -> str:
        return f"{self.asked}: {self.reason}"


Known = dict[str, "RunSummary"]
ENDED = ("finished", "failed", "diverged")


def states(url: str, sweep_id: int, plans: Iterable[Plan]) -> dict[str, str]:
    """By fingerprint, the status of the last attempt that this sweep made at each of these trials.

    A trial that the sweep has not tried yet is left out.
    """
    from runner.database import Logbook
    from runner.database.tables import Run

    asked = {plan.fingerprint for plan in plans}
    with Logbook.read(url) as logbook:
        runs = logbook.runs(Run.sweep_id == sweep_id)  # in the order of their attempts
    return {run.fingerprint: run.status for run in runs if run.fingerprint in asked}


def known(plans: Iterable[Plan]) -> Known:
    """What the logbook has of these trials, by fingerprint; nothing where there is no logbook."""
    from runner.database import Logbook
    from runner.database.address import parse
    from runner.database.schema import Condition, inspect

    plans = list(plans)
    if not plans:
        return {}
    url = plans[0].trial.database_url
    address = parse(url)
    absent = address.path is not None and not address.path.exists()
    if absent or inspect(address) is Condition.EMPTY:
        return {}
    with Logbook.read(url) as logbook:
        found = {plan.fingerprint: logbook.trial(plan.fingerprint) for plan in plans}
    return {key: run for key, run in found.items() if run is not None}


def listed(plans: Sequence[Plan | Refusal]) -> list[tuple[str, str, str]]:
    """(state, trial, remark) of each, for a dry run."""
    runs = known(plan for plan in plans if isinstance(plan, Plan))
    return [_listed(plan, runs) for plan in plans]


def _listed(plan: Plan | Refusal, runs: Known) -> tuple[str, str, str]:
    if isinstance(plan, Refusal):
        return "refused", plan.asked, plan.reason
    run = runs.get(plan.fingerprint)
    if run is None:
        return "new", str(plan.order), ""
    again = run.status == "finished" and plan.trial.rerun
    remark = f"run {run.run_id}"
    if run.error:
        remark += f": {run.error}"
    return run.status, str(plan.order), f"{remark}, to be run again" if again else remark
