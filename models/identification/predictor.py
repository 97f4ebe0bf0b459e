"""Prediction of a recording as a function of free parameters, with their bounds and options.

What is compared with the recording are all states, the velocities alone, or outputs with weights,

    e = weight (y_hat - y) / s

where s is the standard deviation of the measured output y in its file, so that every file and
every output counts alike whatever its size. Outputs are poses and velocities, and loads that were
measured on devices, such as `propeller.thrust`. A measured load that is NaN is left out.

Bounds of each free parameter follow from physics and from the nominal vessel:

    inertia on the diagonal     M_ii / factor <= M_ii <= factor M_ii
    inertia off the diagonal    |M_ij| <= sqrt(M_ii M_jj), as in a positive definite matrix
    damping of its own axis     0 <= d <= WIDE |d|, if the nominal one dissipates
    other                       |p| <= WIDE |p|
    parameters of devices       the plausible range of the device

with the nominal values on the right. A parameter that is nominally zero has the size that
would explain the recorded force alone (`structured.prior_deviation`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification import free_run
from seatrial.models.identification.free_parameters import (
    NED,
    TABLE,
    WINDAGE,
    Coriolis,
    FreeParameters,
    free_parameters,
    nonzero_labels,
    parse_label,
    with_devices,
)
from seatrial.models.identification.free_run import Course, Integrator
from seatrial.models.identification.physical_constraints import PhysicalConstraints, dissipates
from seatrial.models.identification.problem import (
    Force,
    Identifier,
    Needs,
    Problem,
    reference_force,
)
from seatrial.models.identification.structured import prior_deviation
from seatrial.models.notation import DOFS, PLANAR, POSE_UNIT, VELOCITY_UNIT, poses_of, velocities_of
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.device import Device
from seatrial.models.vessel.plant_table import Flags, Layout, bound_plant
from seatrial.models.vessel.table import Vessel

WIDE_MULTIPLE = 5.0  # largest parameter other than inertia, over its nominal size
ZERO_SHARE = 0.1  # of its range, the size of a device's parameter that is nominally zero
ACTIVE = 1e-4  # of the distance between its bounds: a parameter that near to one is at it


def nominal_sizes(free: FreeParameters, recording: Recording | None, force: str | None) -> Array:
    """Size (m,) of each parameter; infinite without a recording where it is nominally zero."""
    sizes = np.where(free.values != 0.0, np.abs(free.values), np.inf)
    if recording is not None:
        phi = basis.evaluate(free.nominal.terms, recording.variables())
        sizes = prior_deviation(free, phi, reference_force(recording, free.nominal, force))
    for i, (_, low, high) in free.plausible:
        sizes[i] = abs(free.values[i]) or ZERO_SHARE * (high - low)
    return sizes


def active_bounds(free: FreeParameters, point: Array, box: tuple[Array, Array]) -> list[Diagnostic]:
    """The parameters of a design point (m,) that are at a bound of the box."""
    diagnostics = []
    rows = zip(free.dofs, free.labels, free.units, point, *box, strict=True)
    for dof, label, unit, value, low, high in rows:
        if min(value - low, high - value) <= ACTIVE * (high - low) < np.inf:
            diagnostics.append(Diagnostic("active_bound", dof, float(value), unit, label=label))
    return diagnostics


@dataclass(frozen=True, eq=False)
class Outputs:
    """The compared states, and then the compared loads of a recording."""

    names: tuple[str, ...]
    dofs: tuple[str, ...]  # `all` for a load
    units: tuple[str, ...]
    columns: tuple[int, ...]  # of the states
    spread: Array  # (n,) size of each output
    scale: Array | None = None  # (N, n) deviation in the file over the weight; None: not weighted
    recording: Recording | None = None  # with the loads
    loads: tuple[int, ...] = ()  # of the loads of the recording

    def with_loads(self, errors: Array, nu: Array, devices: Mapping[str, Device]) -> Array:
        """Predicted - measured (N, n) of all outputs, from that of the states.

        nu (N, n_dof) are the predicted velocities; the devices give the loads.
        """
        assert self.recording is not None
        assert self.recording.loads is not None
        x, columns = replace(self.recording, nu=nu).variables(), [errors]
        for name, place in zip(self.names[len(self.columns) :], self.loads, strict=True):
            device, _, load = name.partition(".")
            own = devices[device].loads(x)[:, devices[device].LOADS.index(load)]
            difference = own - self.recording.loads[:, place]
            columns.append(np.where(np.isfinite(difference), difference, 0.0)[:, None])
        return np.hstack(columns)


def states_of(dofs: tuple[str, ...], spread: Array, names: Sequence[str] | None = None) -> Outputs:
    """The states as outputs, all or those of the `names`; spread (2 n_dof,) is that of all."""
    states = (*poses_of(dofs), *velocities_of(dofs))
    units = [unit[dof] for unit in (POSE_UNIT, VELOCITY_UNIT) for dof in dofs]
    columns = tuple(i for i, name in enumerate(states) if names is None or name in names)
    own, of, unit = (tuple(each[i] for i in columns) for each in (states, dofs * 2, units))
    return Outputs(own, of, unit, columns, spread[list(columns)])


def weighted_outputs(
    weights: Mapping[str, float], recording: Recording, nominal: Vessel
) -> Outputs:
    """The outputs with a weight; raises ConfigurationError for one that is not known.

    A load that the recording does not have is left out.
    """
    check_outputs(weights, nominal)
    states = states_of(nominal.dofs, np.ones(2 * len(nominal.dofs)), list(weights))
    loads = tuple(i for i, name in enumerate(recording.load_names) if name in weights)
    names = (*states.names, *(recording.load_names[i] for i in loads))
    measured = np.hstack([recording.eta, recording.nu])[:, states.columns]
    if recording.loads is not None:
        measured = np.hstack([measured, recording.loads[:, loads]])
    file = np.zeros(len(recording), dtype=np.int64) if recording.file is None else recording.file
    scale = np.ones_like(measured)
    for number in np.unique(file):
        deviation = np.std(measured[file == number], axis=0)
        scale[file == number] = np.where(deviation > 0.0, deviation, 1.0)  # 1 for NaN
    scale /= [weights[name] for name in names]
    dofs, units = (*states.dofs, *("all" for _ in loads)), (*states.units, *("N" for _ in loads))
    spread = np.asarray(np.median(scale, axis=0))
    return Outputs(names, dofs, units, states.columns, spread, scale, recording, loads)


def check_outputs(weights: Mapping[str, float], nominal: Vessel) -> None:
    """Raise ConfigurationError for an output that is not known, and for a weight of zero."""
    states = (*poses_of(nominal.dofs), *velocities_of(nominal.dofs))
    loads = [f"{name}.{load}" for name, each in nominal.devices.items() for load in each.LOADS]
    wrong = [name for name in weights if name not in (*states, *loads)]
    if wrong or not set(weights) & set(states):
        got, expected = wrong[0] if wrong else "no state", ", ".join((*states, *loads))
        raise ConfigurationError(f"identifier.outputs: got {got}, expected some of {expected}")
    for name, weight in weights.items():
        if not weight > 0.0:
            raise ConfigurationError(f"identifier.outputs.{name} must be positive, got {weight:g}")


STEERED_PRIOR = 0.3  # of a parameter of a vessel with inputs, over its nominal size


@dataclass(frozen=True, eq=False)
class Predictor:
    """Predict a recording from design points, shape (m,) of the free parameters; SI units."""

    free: FreeParameters
    plan: Layout
    course: Course
    integrator: Integrator
    outputs: Outputs | None = None  # what is compared; None: all states

    @cached_property
    def compared(self) -> Outputs:
        """What is compared."""
        return self.outputs or self.states

    @cached_property
    def states(self) -> Outputs:
        """All states: poses, then velocities."""
        return states_of(self.free.nominal.dofs, self.spread)

    @cached_property
    def spread(self) -> Array:
        """Standard deviation of each measured state, 1 for one that does not move."""
        deviation = free_run.spread(self.course)
        return np.where(deviation > 0.0, deviation, 1.0)

    def predict(self, point: Array, offset: Array | None = None) -> Array:
        """States of one design point, shape (N, n_pose + n_dof).

        `offset` (n, 2 n_dof) is added to the measured initial states of the n predictions. The
        result is NaN if the inertia is not positive definite.
        """
        course = self.course if offset is None else self.course.with_offset(offset)
        tables = self.free.tables(point[None])
        inverses, realistic = self.plan.inverse_inertia(tables)
        if not realistic[0]:
            return np.full_like(course.reached, np.nan)
        plant = self.plan.plant(tables[0], inverses[..., 0])
        plant = plant._replace(parameters=self.free.device_parameters(point[None])[:, 0].copy())
        predicted = np.empty_like(course.reached)
        free_run.predict(plant, course, self.integrator == "euler", predicted)
        return predicted

    def predict_many(self, points: Array, offsets: Array) -> Array:
        """States of n design points (n, m), shape (n, N, n_pose + n_dof); see `predict`.

        `offsets` (n, n_starts, 2 n_dof) are those of each point.
        """
        tables = self.free.tables(points)
        inverses, realistic = self.plan.inverse_inertia(tables)
        starts = np.stack([self.course.starts(offset) for offset in offsets], axis=2)
        predicted = np.empty((len(points), *self.course.reached.shape))
        free_run.predict_many(
            bound_plant(self.plan.structure, True), self.plan.entries(tables), inverses,
            self.free.device_parameters(points), self.course, starts,
            self.integrator == "euler", predicted,
        )  # fmt: skip
        predicted[~realistic] = np.nan
        return predicted

    def mismatch(self, point: Array, offset: Array | None = None) -> Array:
        """Predicted - measured of what is compared, attitudes by rotation vectors, (N, n)."""
        return np.asarray(self._compared(self.predict(point, offset)[None], point[None])[0])

    def mismatches(self, points: Array, offsets: Array) -> Array:
        """`mismatch` of n design points (n, m), shape (n, N, n_outputs); see `predict_many`."""
        return self._compared(self.predict_many(points, offsets), points)

    def _compared(self, predicted: Array, points: Array) -> Array:
        n, course, compared = len(self.free.nominal.dofs), self.course, self.compared
        if compared.columns == tuple(range(n, 2 * n)):  # a pose's deviation takes most of the time
            return np.asarray(predicted[..., -n:] - course.measured[:, n:])
        found = []
        for state, point in zip(predicted, points, strict=True):
            errors = free_run.deviations(course.kinematics, course.reached, state)
            errors = errors[:, compared.columns]
            if compared.loads:
                errors = compared.with_loads(errors, state[:, -n:], self.free.devices(point))
            found.append(errors)
        return np.array(found)

    def errors(self, points: Array, metric: str) -> tuple[Array, Array, Flags]:
        """Prediction errors of n design points (n, m), per state, shape (n, 2 n_dof).

        Also the share of limited rates (n,), and whether the inertia is positive definite (n,).
        """
        tables = self.free.tables(points)
        inverse, realistic = self.plan.inverse_inertia(tables)
        errors = np.empty((len(points), len(self.spread)))
        limited = np.empty(len(points))
        free_run.prediction_errors(
            bound_plant(self.plan.structure, True), self.plan.entries(tables), inverse,
            self.free.device_parameters(points), self.course, self.integrator == "euler",
            free_run.METRICS.index(metric), errors, limited,
        )  # fmt: skip
        stages = 1 if self.integrator == "euler" else 4
        return errors, limited / (stages * self.course.reached.size), realistic


def _canonical(label: str) -> str:
    """The label with the canonical name of the term, such as `surge.u^2` for `surge.uu`."""
    dof, dot, name = label.partition(".")
    return f"{dof}.{basis.term(name)}" if dot and dof in DOFS else label


@dataclass(frozen=True)
class PredictionOptions(Identifier):
    """Common options of the identifiers that compare predictions with a recording.

    The YAML files say what each option is. A free run accumulates unmodelled forces, hence the
    `ned_force` and the `windage`. `bounds` are `dof.term: [lower, upper]`, in any spelling of the
    term; the other parameters have those of `box`, and all together physical constraints. Null
    stands for: `parameters`, the nonzero ones of the nominal table; `ned_force`, a vessel in surge,
    sway and yaw commanded by forces; `windage`, beside the whole table of a vessel in surge, sway
    and yaw; `force`, the best one known.
    """

    free: tuple[str, ...]
    parameters: tuple[str, ...] | None
    prior: Positive | Literal["auto"] | None
    deviations: dict[str, float]
    coriolis: Coriolis
    ned_force: bool | None
    windage: bool | None
    bounds: dict[str, tuple[float, ...]]
    inertia_factor: Annotated[float, Gt(1)] | None
    force: Force | None
    integrator: Integrator
    horizon: Annotated[int, Ge(2)] | None
    derivative_limit: Positive

    @property
    def protected(self) -> bool:
        """Physical constraints and nominal equations where they predict better go together."""
        return self.inertia_factor is not None

    @property
    def output_weights(self) -> dict[str, float] | None:
        """Weights of the outputs that are compared; None: all states, each by its own noise."""
        return None

    def __post_init__(self) -> None:
        check_ranges(self)
        for label, pair in self.bounds.items():
            if len(pair) != 2 or not pair[0] < pair[1]:
                raise ConfigurationError(
                    f"bounds.{label}: expected a lower and a higher number, got {list(pair)}"
                )
        bounds = {_canonical(label): pair for label, pair in self.bounds.items()}
        object.__setattr__(self, "bounds", bounds)

    def needs(self) -> Needs:
        """The force of the prediction."""
        return Needs(self.force, thruster_lag=self.force == "filtered")

    def unknowns(self, nominal: Vessel, windy: bool = False) -> FreeParameters:
        """The free parameters of a vessel; raises ConfigurationError for unknown ones.

        `windy` says that the wind was measured.
        """
        planar, whole = nominal.dofs == PLANAR, TABLE in self.free and self.parameters is None
        with_force = planar and nominal.forces_commanded
        with_force = with_force if self.ned_force is None else self.ned_force
        with_wind = windy and (planar and whole if self.windage is None else self.windage)
        labels = list(self.parameters or ()) if TABLE in self.free else []
        if whole:
            labels = [label for label, _ in nonzero_labels(nominal, self.coriolis)]
        others = [name for name in self.free if name != TABLE]
        own = [name for name in others if name.partition(".")[0] in nominal.dofs]
        further = [*map(_canonical, own), *(WINDAGE if with_wind else ())]
        labels += [name for name in further if name not in labels]
        symmetric = self.inertia_factor is not None
        free = free_parameters(nominal, labels, self.coriolis, with_force, symmetric)
        free = with_devices(free, [name for name in others if name not in own])
        if not len(free):
            raise ConfigurationError(f"identifier.free: {nominal.name} has nothing to identify")
        for label in set(self.bounds) - set(free.labels):
            raise ConfigurationError(
                f"bounds.{label}: not a parameter, expected one of {', '.join(free.labels)}"
            )
        for i, plausible in free.plausible:
            for end in self.bounds.get(free.labels[i], ()):
                plausible.check(f"bounds.{free.labels[i]}", end)
        return free

    def predictor(self, problem: Problem, horizon: int | None = None) -> Predictor:
        """Predictor of the training part; `horizon` overrides the option."""
        free = self.unknowns(problem.nominal, problem.training.wind is not None)
        nominal = free.nominal
        plan = free_run.predicted_layout(nominal, free.support)
        course = free_run.course_of(
            problem.training, problem.thruster, self.force, horizon or self.horizon,
            self.derivative_limit, nominal.attitude,
        )  # fmt: skip
        outputs = None
        if self.output_weights is not None:
            outputs = weighted_outputs(self.output_weights, problem.training, nominal)
        return Predictor(free, plan, course, self.integrator, outputs)

    def prior_of(self, free: FreeParameters, recording: Recording) -> Array:
        """Standard deviations (m,) about the nominal values, infinite where there are none.

        Raises ConfigurationError for a pattern without a match.
        """
        relative, deviation = self.prior, np.full(len(free), np.inf)
        if relative == "auto":
            relative = STEERED_PRIOR if free.nominal.inputs else None
        if relative is not None:
            deviation = relative * nominal_sizes(free, recording, self.force)
        for pattern, value in self.deviations.items():
            own = pattern.partition(".")[0] in free.nominal.dofs
            named = _canonical(pattern) if own else pattern
            chosen = [label == named or fnmatchcase(label, pattern) for label in free.labels]
            if not any(chosen):
                raise ConfigurationError(
                    f"identifier.deviations.{pattern}: not a parameter, expected some of "
                    f"{', '.join(free.labels)}"
                )
            deviation[chosen] = value
        return deviation

    def constraints(self, free: FreeParameters, recording: Recording) -> PhysicalConstraints:
        """The bounds and physical constraints of the parameters."""
        sizes, box = nominal_sizes(free, recording, self.force), self.box(free, recording)
        return PhysicalConstraints(free, recording.nu, self.inertia_factor, sizes, box)

    def box(self, free: FreeParameters, recording: Recording | None = None) -> tuple[Array, Array]:
        """Lower and upper bounds (m,) of the parameters, infinite where there are none.

        Parameters that are nominally zero have physical bounds by the recording only.
        """
        upper, table, factor = np.full(len(free), np.inf), free.nominal, self.inertia_factor
        if factor is not None:
            upper = WIDE_MULTIPLE * nominal_sizes(free, recording, self.force)
        lower, diagonal = -upper, dict(zip(table.dofs, np.diag(table.inertia), strict=True))
        for i, (label, value) in enumerate(zip(free.labels, free.values, strict=True)):
            if factor is None or label in NED or i >= free.of_devices.start:
                continue
            dof, term = parse_label(label, table)
            k = table.dofs.index(dof)
            if term.name == table.accelerations[k]:
                lower[i], upper[i] = value / factor, value * factor
            elif term.name in table.accelerations:
                other = table.dofs[table.accelerations.index(term.name)]
                upper[i] = np.sqrt(diagonal[dof] * diagonal[other])
                lower[i] = -upper[i]
            elif value > 0.0 and not table.inputs and dissipates(term, table.velocities[k]):
                lower[i] = 0.0
        for i, plausible in free.plausible:
            lower[i], upper[i] = plausible.low, plausible.high
        for i, label in enumerate(free.labels):
            if label in self.bounds:
                lower[i], upper[i] = self.bounds[label]
        return lower, upper
