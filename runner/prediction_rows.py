"""The rows of how well the models predict the held-out part: one step, ten steps, a free run."""

import numpy as np

from models.errors import IdentificationError
from models.identification.problem import Identified, Problem
from models.identification.validation import AHEAD, Ahead, prediction
from models.vessel import FORCE_UNIT, Vessel
from runner import rows
from runner.database.records import Diagnostic, Metric

UNKNOWN = Ahead(np.array(np.nan), float("nan"))  # of a model that cannot predict


def metrics(
    problem: Problem, identified: Identified, truth: Vessel | None
) -> tuple[list[Metric], list[Diagnostic]]:
    """Root mean square error of pose and velocity on the held-out part, of every model.

    One step and ten steps after every measured state, and a free run. A model that cannot predict
    has empty figures and its reason as a diagnostic.
    """
    models = {"nominal": problem.nominal, "identified": identified.model}
    if truth is not None:
        models["plant"] = truth
    held_out, dofs = problem.validation, problem.validation.dofs
    forces = [FORCE_UNIT[dof] for dof in dofs]
    units = {"pose": [rows.POSE_UNIT[one] for one in forces]}
    units["velocity"] = [rows.SPEED_UNIT[one] for one in forces]
    found: list[Metric] = []
    reasons: list[Diagnostic] = []
    for model, table in models.items():
        try:
            ready = prediction(table, held_out, problem.thruster)
            errors = {name: ready.ahead(steps) for name, steps in AHEAD.items()}
        except IdentificationError as error:
            reason = f"{model} model: {error}"
            reasons.append(Diagnostic("no_prediction", "all", None, None, reason, 1.0, ""))
            errors = dict.fromkeys(AHEAD, UNKNOWN)
        for name, (rmse, limited) in errors.items():
            halves = np.split(np.broadcast_to(rmse, 2 * len(dofs)), 2)
            for (what, unit), half in zip(units.items(), halves, strict=True):
                found += rows.per_dof("validation", model, f"{what}_rmse_{name}", half, dofs, unit)
            found.append(Metric("validation", model, "all", f"limited_share_{name}", limited, ""))
    return found, reasons
