"""An informative mix of sub-experiments. Ljungberg (slides), after his thesis.

Standard manoeuvres are sailed by the believed model in calm water; the mix that tells its
coefficients apart best is rounded to whole sub-experiments and sailed, each from rest. Others are
sailed after it, held out for testing. A random mix is the baseline: so many drawn from a pool of
some of every manoeuvre.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.candidates import Believed, Design
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.missions import Mission
from seatrial.models.excitation.open_loop import Steering
from seatrial.models.excitation.route import Route, parts_of
from seatrial.models.excitation.schedule import Gains, Role, Schedule, check_open
from seatrial.models.planning.planner import Plan
from seatrial.models.recording.splits import Split
from seatrial.models.simulation.registry import Timetable
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.table import PLANAR


@dataclass(frozen=True)
class Mix(Mission):
    """`sub_experiments` of the candidates, each `length_s` x `time_scale` long.

    `design`: optimal, by the believed model of `vessel`, or random, drawn with `draw_seed` from a
    pool of `repeats` of every candidate. `stop_s` (x `time_scale`) of velocity feedback bring the
    vessel to rest after each. `held_out` are sailed last, for testing. In the area of `route` the
    order and what lies between follow from a plan.
    """

    candidates: dict[str, Mission]
    sub_experiments: int
    design: Literal["optimal", "random"]
    repeats: int
    draw_seed: int
    held_out: tuple[str, ...]
    length_s: float
    stop_s: float
    time_scale: float
    vessel: VesselParameters
    believed: Believed
    extra_terms: tuple[str, ...]  # that the mix is to tell apart, beside the vessel's own
    feedback: Gains
    route: Route
    reference_filter: Reference
    period_s: float

    def __post_init__(self) -> None:
        for name in ("length_s", "stop_s", "time_scale", "period_s"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("sub_experiments", "repeats"):
            if not getattr(self, name) > 0:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")
        pool = self.repeats * len(self.candidates)
        if self.design == "random" and self.sub_experiments > pool:
            raise ConfigurationError(
                f"sub_experiments must be at most the pool's {pool}, got {self.sub_experiments}"
            )
        unknown = [name for name in self.held_out if name not in self.candidates]
        if unknown or not self.held_out:
            raise ConfigurationError(
                f"held_out: got {unknown[0] if unknown else 'none'}, expected some of "
                f"{', '.join(self.candidates)}"
            )
        basis.terms(self.extra_terms)

    @property
    def open_loop(self) -> bool:
        """No controller of the trial takes part; the vessel is stopped by feedback of its own."""
        return True

    @cached_property
    def information(self) -> Design:
        """What the believed model says of the candidates."""
        nominal = self.vessel.nominal()
        own = nominal.terms
        extra = tuple(one for one in basis.terms(self.extra_terms) if one not in own)
        count, stop = (
            max(2, round(s * self.time_scale / self.period_s)) for s in (self.length_s, self.stop_s)
        )
        return Design(
            candidates=self.candidates,
            plant=self.vessel.plant(self.believed.model(nominal)),
            terms=own + extra,
            gains=self.feedback,
            limits=self._limits,
            count=count,
            stop=stop,
            period_s=self.period_s,
            reference_filter=self.reference_filter,
        )

    @property
    def _limits(self) -> Array:
        known = self.vessel.limits_by_dof
        return np.array([known.get(dof, np.inf) for dof in self.vessel.dofs])

    @cached_property
    def counts(self) -> dict[str, int]:
        """Sub-experiments of every candidate in the mix, without those held out."""
        if self.design == "optimal":
            counts = self.information.counts(self.sub_experiments)
        else:
            pool = np.repeat(np.arange(len(self.candidates)), self.repeats)
            rng = np.random.default_rng(self.draw_seed)
            drawn = rng.choice(pool, self.sub_experiments, replace=False)
            counts = np.bincount(drawn, minlength=len(self.candidates)).astype(np.int64)
        return {name: int(n) for name, n in zip(self.candidates, counts, strict=True)}

    @cached_property
    def plan(self) -> Plan | None:
        """The path of the manoeuvres through the area; None where there is none."""
        return self.route.plan(self.information, self._to_be_sailed)

    @property
    def _to_be_sailed(self) -> list[str]:
        """The mix in the order of the candidates, then what is held out."""
        return [*(name for name, n in self.counts.items() for _ in range(n)), *self.held_out]

    @cached_property
    def schedule(self) -> Schedule:
        """The mix and then what is held out; along a plan, of each candidate the last."""
        if self.plan is not None:
            everywhere = self.route.follow == "everywhere"
            parts = parts_of(self.plan, self.information, self.held_out, everywhere)
            return self.information.schedule(parts)
        names, trained = self._to_be_sailed, sum(self.counts.values())
        roles: list[Role] = ["training" if i < trained else "testing" for i in range(len(names))]
        each = map(self.information.sub_experiment, names, roles)
        return self.information.schedule([part for pair in each for part in pair])

    @property
    def start(self) -> Array:
        """The pose that it begins at [m, m, rad], shape (3,)."""
        return np.zeros(3) if self.plan is None else self.plan.start

    @property
    def duration_s(self) -> float:
        """Length of all sub-experiments with their stops [s]."""
        return len(self.schedule) * self.period_s

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """Nothing is asked for, or along a plan its poses."""
        if self.plan is None:
            return Timetable(np.tile(start, (len(t), 1))), np.zeros(1)
        return Timetable(np.ascontiguousarray(self.plan.poses[: len(t)])), np.zeros(1)

    def force(self, t: Array, dofs: Sequence[str], rng: np.random.Generator) -> Array:
        """Force of the manoeuvres [N, Nm] at the times t [s], shape (N, n_dof)."""
        return self.schedule.force()[: len(t)]

    def steering(self, dofs: Sequence[str], period_s: float) -> Steering | None:
        """What stands in for the controller."""
        return self.schedule.steering(self.feedback, self._limits)

    def split(self, t: Array) -> Split:
        """Training: the manoeuvres of the mix; testing: those held out."""
        n = len(t)
        return Split(
            self.schedule.mask("training")[:n].copy(), self.schedule.mask("testing")[:n].copy()
        )

    def check(self, dofs: Sequence[str]) -> None:
        """A vessel in the plane, and a mix that can be designed."""
        if tuple(dofs) != PLANAR:
            raise ConfigurationError(
                f"excitation=mix needs a vessel in {', '.join(PLANAR)}, got one in "
                f"{', '.join(dofs)}"
            )
        for name, candidate in self.candidates.items():
            check_open(name, candidate, dofs, self.period_s)
        if len(self.feedback.kp) != 3 or len(self.feedback.kd) != 3:
            raise ConfigurationError(
                f"excitation.feedback: got {len(self.feedback.kp)} and {len(self.feedback.kd)} "
                "numbers, expected 3 each"
            )
        _ = self.schedule

    def check_limits(self, limits: Mapping[str, float], period_s: float) -> None:
        """Raise ConfigurationError where a force exceeds what the thrusters can give."""
        for name, candidate in self.candidates.items():
            try:
                candidate.check_limits(limits, period_s)
            except ConfigurationError as error:
                what = str(error).removeprefix("excitation.")
                raise ConfigurationError(f"excitation.candidates.{name}.{what}") from error
