"""A model of a stored run, and the vessel that it describes.

The node of a vessel has the content of a file in `conf/vessel`: the thrusters, limits and tuning
of the run's vessel, with the coefficients of the model instead of its own. Every coefficient is a
derivative of its own there, so that reading it again gives the same numbers.

A stored model as a vessel of the configuration: YAML with comments, and JSON.
"""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import yaml

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.models.notation import ACCELERATIONS, DOFS, PLANAR, poses_of
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration import options
from seatrial.runner.database import LogbookReader
from seatrial.runner.database.records import RunDetail
from seatrial.runner.record.coefficient_rows import device_values, vessel_of
from seatrial.runner.record.rows import Coefficient
from seatrial.runner.record.vocabulary import GROUPS, Config

DERIVATIVE_LETTERS = "XYZKMN"  # of the forces, in the order of DOFS
ADAPTIVE = "adaptive"  # stored as adaptive_1, adaptive_2, ...; the last one is meant
STATE_SPACE = "state_space"


@dataclass(frozen=True, eq=False)
class StoredModel:
    """The coefficient table of one model of a run."""

    run: RunDetail
    model: str  # nominal, identified, plant or adaptive
    table: Vessel
    state_space: StateSpace | None = None  # that was identified, with all its inputs
    device_values: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # identified
    standard_errors: Mapping[str, float] = field(default_factory=dict)  # of what was identified
    motion: Callable[[], Mapping[str, Array]] = dict  # reads the columns of the recording

    @property
    def name(self) -> str:
        """Name of the vessel, such as milliampere_17 for the identified model of run 17."""
        own = str(self._stored_vessel.get("name", self.run.summary.vessel))
        suffix = "" if self.model == "identified" else f"_{self.model}"
        return f"{own}_{self.run.summary.run_id}{suffix}"

    @property
    def source(self) -> str:
        """What the model is and where it comes from, in one line."""
        summary = self.run.summary
        options = ", ".join(f"{group}={getattr(summary, group)}" for group in GROUPS[:4])
        return f"{self.model} model of run {summary.run_id} ({options}, seed={summary.seed})"

    @cached_property
    def node(self) -> Config:
        """The vessel as a node of the configuration."""
        node = dict(self._stored_vessel)
        body_of = dict.fromkeys(("body", "parameters"), None)
        node |= body_of | {
            "name": self.name,
            "dofs": list(self.table.dofs),
            "inertia": self.table.inertia.tolist(),
            "derivatives": derivatives_of(self.table),
            **({"standard_errors": dict(self.standard_errors)} if self.standard_errors else {}),
            "coriolis": False,
            "parameter_sets": {},
        }
        if node.get("inputs"):  # the derivatives are in SI units, those of restoring among them
            node |= {"prime": None, "restoring": {}, "devices": self._devices}
        if self.model != "nominal":
            node["plant_scale"] = 1.0
        read, own = self.run.config.get("excitation") or {}, node.get("sources") or {}
        trained = [*filter(None, [read.get("path")]), *(read.get("train") or ())]
        if trained and self.model == "identified":
            node["regressed_on"] = [*node.get("regressed_on", ()), *trained]
        taken = dict.fromkeys(("inertia", "derivatives"), self.source)
        replaced = ("body", "parameter_sets", "parameters", "plant_scale")
        node["sources"] = taken | {
            key: text for key, text in own.items() if key not in {*taken, *replaced}
        }
        return node

    @cached_property
    def parameters(self) -> VesselParameters:
        """The vessel with its thrusters and limits; raises ConfigurationError if it is invalid."""
        try:
            vessel = options.part(VesselParameters, self.node)
        except options.OptionError as error:
            raise ConfigurationError(f"{self.source}: {error.at('vessel')}") from error
        assert isinstance(vessel, VesselParameters)
        return vessel

    @property
    def step_s(self) -> float:
        """The integration step of the run [s]."""
        return float(self.run.config["integration_step_s"])

    @property
    def _devices(self) -> Config:
        """The devices of the run's vessel, with the parameters that were identified."""
        stored = self._stored_vessel.get("devices") or {}
        return {
            name: {**options, **self.device_values.get(name, {})}
            for name, options in stored.items()
        }

    @property
    def _stored_vessel(self) -> Config:
        vessel: Config = self.run.config["vessel"]
        return vessel


def read_model(
    logbook: LogbookReader, run_id: int, model: str = "identified", linear: bool = False
) -> StoredModel:
    """Read a model (nominal, identified, plant, adaptive) of a run.

    With `linear`, the identified state-space model is read as well, if there is one; its period
    follows from the series of the recording. Raises LogbookError if there is no such run, or if it
    has stored no such model.
    """
    run = logbook.run(run_id)
    rows: dict[str, list[Coefficient]] = {}
    for row in logbook.coefficients(run_id):
        rows.setdefault(row.model, []).append(row)
    key = model
    if model == ADAPTIVE:
        versions = [name for name in rows if re.fullmatch(rf"{ADAPTIVE}_\d+", name)]
        key = max(versions, key=lambda name: int(name.rpartition("_")[2]), default=model)
    if key not in rows:
        known: list[str] = [name for name in ("nominal", "identified", "plant") if name in rows]
        known += [ADAPTIVE] if any(name.startswith(ADAPTIVE) for name in rows) else []
        raise LogbookError(
            f"run {run_id} ({run.summary.status}) has no model {model!r}, "
            f"expected {'one of ' + ', '.join(known) if known else 'a run that stored a model'}"
        )
    if not isinstance(run.config.get("vessel"), dict):
        raise LogbookError(f"run {run_id} has no configuration of a vessel, expected vessel: ...")
    table = vessel_of(rows[key], f"{model} model of run {run_id}")
    attitude = run.config["vessel"].get("attitude", "quaternion")
    stored = None
    if linear and model == "identified" and STATE_SPACE in rows:
        stored = _state_space(logbook, run, rows[STATE_SPACE], table.dofs)
    devices = device_values(rows[key])
    letters = dict(zip(DOFS, DERIVATIVE_LETTERS, strict=True))
    errors = {
        f"{letters[row.dof]}_{row.term.replace('_dot', 'dot')}": row.std_error
        for row in rows[key]
        if row.std_error is not None and row.dof in table.dofs
    }
    found = StoredModel(
        run, model, replace(table, attitude=attitude), stored, devices, errors,
        lambda: logbook.series(run_id, "recording").columns,
    )  # fmt: skip
    if not run.config["vessel"].get("inputs"):
        return found
    steered = found.parameters
    full = replace(found.table, inputs=steered.input_names, devices=steered.devices)
    return replace(found, table=full)


def derivatives_of(table: Vessel) -> dict[str, float]:
    """The non-zero entries but the inertia matrix as hydrodynamic derivatives, `X_|u|u`, in SI."""
    letters = [DERIVATIVE_LETTERS[DOFS.index(dof)] for dof in table.dofs]
    return {
        f"{letter}_{term.name}": -float(value)
        for term, row in zip(table.terms, table.theta, strict=True)
        if term.name not in ACCELERATIONS
        for letter, value in zip(letters, row, strict=True)
        if value
    }


def _state_space(
    logbook: LogbookReader, run: RunDetail, rows: list[Coefficient], dofs: tuple[str, ...]
) -> StateSpace:
    """The state-space model of its stored entries, which are complete."""
    entries: dict[str, dict[tuple[int, ...], float | None]] = {}
    for row in rows:
        name, _, place = row.term.rstrip("]").partition("[")
        entries.setdefault(name, {})[tuple(int(i) - 1 for i in place.split(","))] = row.value
    matrices = {name: _matrix(values) for name, values in entries.items()}
    inputs = [f"tau_{dof}" for dof in dofs]
    inputs += [f"input_{i + 1}" for i in range(len(dofs), matrices["B"].shape[1])]
    for diagnostic in logbook.diagnostics(run.summary.run_id):
        if diagnostic.name == "markov" and diagnostic.j is not None and diagnostic.label:
            inputs[diagnostic.j - 1] = diagnostic.label
    identifier = run.config["identifier"]
    body = identifier.get("output", "body_pose") == "body_pose" and dofs in (PLANAR, DOFS)
    return StateSpace(
        **matrices,
        period_s=_period(logbook, run, identifier),
        inputs=tuple(inputs),
        outputs=tuple(f"body_{name}" if body else name for name in poses_of(dofs)),
    )


def _period(logbook: LogbookReader, run: RunDetail, identifier: Config) -> float:
    """The sample time of the identified state-space model [s]: whole samples of the recording."""
    t = logbook.series(run.summary.run_id, "recording").columns["t"]
    span = t[-1] - t[0]
    recorded = float(span / round(span / np.median(np.diff(t))))  # as Recording.period_s
    asked = identifier.get("period_s") or identifier.get("hold_s") or recorded
    return float(asked) if asked == recorded else max(round(asked / recorded), 1) * recorded


def _matrix(values: Mapping[tuple[int, ...], float | None]) -> Array:
    matrix = np.zeros(np.max(np.array(list(values)), axis=0) + 1)
    for place, value in values.items():
        matrix[place] = np.nan if value is None else value
    return matrix


HEAD = """\
# {source}.
# Sail it with vessel=PATH-OF-THIS-FILE, or with vessel=run:{run} and the database of the run.
# Thrusters, limits and tuning are those of the vessel {vessel}. The terms of the equation of motion
# are listed one by one: coriolis is false because its terms are among the derivatives.
"""


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Writes lists of numbers in a line, and floats so that YAML reads the same numbers."""

    def ignore_aliases(self, data: object) -> bool:
        """Write everything in full."""
        return True


def _list(dumper: yaml.SafeDumper, values: list[object]) -> yaml.SequenceNode:
    flat = not any(isinstance(value, dict | list) for value in values)
    return dumper.represent_sequence("tag:yaml.org,2002:seq", values, flow_style=flat)


def _float(dumper: yaml.SafeDumper, value: float) -> yaml.ScalarNode:
    text = repr(value)  # the shortest that gives the same number; YAML takes `1e+20` for a text
    if "e" in text and "." not in text:
        text = text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


_Dumper.add_representer(float, _float)
_Dumper.add_representer(list, _list)


def as_yaml(model: StoredModel) -> str:
    """The vessel as a file of the group `vessel`."""
    head = HEAD.format(
        source=model.source, run=model.run.summary.run_id, vessel=model.run.summary.vessel
    )
    return head + str(
        yaml.dump(model.node, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000)
    )


def as_json(model: StoredModel) -> str:
    """The same node as data."""
    return json.dumps(model.node, indent=2, ensure_ascii=False) + "\n"
