"""The catalogue of metrics: what trials store is declared, and what is declared is stored."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS, FORCE_UNIT, POSE_UNIT, VELOCITY_UNIT
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import build_trial
from seatrial.runner.record import catalogue
from seatrial.runner.record.catalogue import METRICS, Definition
from seatrial.runner.record.own_metrics import OwnMetric
from seatrial.runner.record.rows import Metric, metric
from seatrial.runner.trials import trial as trials
from tests.runner.record.test_optimal_design_results import SHORT
from tests.runner.record.test_recording_results import SURGE, write
from tests.trials import composed

FORCE_IN_THE_LAG = ("identifier=ls", "disturbance=constant")  # a ferry of known thruster lag
POSITIONING = (  # set-points, limits, wind, and an allocation that cannot give every force
    "vessel=supply_vessel", "vessel.thrusters.method=qp", "controller=mpc_reduced",
    "excitation=prbs", "excitation.length_s=10", "identifier=none", "evaluation=setpoints",
    "evaluation.duration_s=600", "disturbance=wind",
)  # fmt: skip
DOCKING = (
    "excitation=prbs", "excitation.length_s=10", "identifier=none", "evaluation=docking",
    "controller=lqi",
)  # fmt: skip
SURGE_STEPS = ("evaluation=setpoints", "evaluation.duration_s=200", "controller=pid_ff")


@pytest.fixture
def own(monkeypatch: pytest.MonkeyPatch) -> Definition:
    """A metric of a part from elsewhere."""
    monkeypatch.setattr(catalogue, "_declared", dict(catalogue._declared))
    return catalogue.register(
        Definition("own_vaf", ("validation",), "%", "higher", "VAF", "variance accounted for")
    )


def stored_by(*overrides: str) -> list[Metric]:
    return list(trials.run(composed(*overrides)).metrics)


@pytest.mark.slow
def test_what_trials_store_is_what_is_declared(tmp_path: Path) -> None:
    stored = [
        *stored_by(*FORCE_IN_THE_LAG),
        *stored_by(*POSITIONING),
        *stored_by(*SHORT),
        *stored_by(*DOCKING),
        *stored_by(*SURGE, f"excitation.path={write(tmp_path / 'a.csv')}"),
    ]
    declared = {(stage, one.name) for one in METRICS for stage in one.stages}
    assert {(row.stage, row.name) for row in stored} == declared
    assert all(row.unit == catalogue.declared(row.name).unit_of(row.dof) for row in stored)


def test_a_mean_square_has_the_square_of_the_unit_of_the_mean() -> None:
    for name in ("force", "e_pos", "e_psi", "error"):
        mean, square = catalogue.declared(f"{name}_mae"), catalogue.declared(f"{name}_mse")
        dofs = [dof for dof in (*DOFS, "position", "heading") if dof in mean.unit]
        assert dofs
        for dof in dofs:
            unit = mean.unit_of(dof)
            assert square.unit_of(dof) in (f"{unit}^2", f"({unit})^2")


def test_units_are_those_of_the_notation_and_predictions_have_every_horizon() -> None:
    assert catalogue.declared("tau_mean_abs").unit == FORCE_UNIT
    for horizon in catalogue.HORIZONS:
        for quantity, units in (("pose", POSE_UNIT), ("velocity", VELOCITY_UNIT)):
            assert catalogue.declared(f"{quantity}_rmse_{horizon}").unit == units
            for score in ("fit", "r2", "vaf"):
                one = catalogue.declared(f"{quantity}_{score}_{horizon}")
                assert (one.better, one.score) == ("higher", True)


def test_what_is_not_declared_is_not_stored() -> None:
    with pytest.raises(KeyError, match="metric speed: got no definition"):
        metric("speed", "validation", "nominal", "surge", 1.0)
    with pytest.raises(KeyError, match="force_mse: got dof 'heading', expected one of surge"):
        metric("force_mse", "validation", "nominal", "heading", 1.0)
    with pytest.raises(ValueError, match="force_mse: got stage deployment, expected validation"):
        metric("force_mse", "deployment", "nominal", "surge", 1.0)


def test_a_part_from_elsewhere_declares_its_own(own: Definition) -> None:
    row = metric("own_vaf", "validation", "identified", "surge", np.float64(99.0))
    assert row == Metric("validation", "identified", "surge", "own_vaf", 99.0, "%")
    assert catalogue.register(own) is own
    assert catalogue.all_declared()[-1] is own
    other = Definition("own_vaf", ("validation",), "", "lower", "VAF", "something else")
    with pytest.raises(ValueError, match="own_vaf: got a second definition"):
        catalogue.register(other)
    with pytest.raises(ValueError, match="got name 'Own VAF'"):
        catalogue.register(Definition("Own VAF", (), "", None, "", ""))


@dataclass(frozen=True)
class Reach(OwnMetric):
    """How far from the start a vessel came, and how large a model's damping ahead is."""

    scale: float = 1.0
    definition = Definition(
        "own_reach", ("validation", "deployment"), {"position": "m", "surge": "kg/s"}, None, "", ""
    )

    def of_model(self, held_out: Recording, model: Vessel) -> Mapping[str, float]:
        return {"surge": self.scale * model.coefficient("surge", "u")}

    def of_voyage(self, voyage: Voyage) -> Mapping[str, float]:
        distance = np.linalg.norm((voyage.log.eta - voyage.log.eta[0])[:, :2], axis=1)
        return {"position": self.scale * float(np.max(distance))}


def test_a_metric_from_elsewhere_is_stored_beside_ours(own: Definition) -> None:
    trial = composed("vessel=surge_linear", "excitation=prbs", "identifier=ls", *SURGE_STEPS)
    results = trials.run(replace(trial, metrics=(Reach(2.0),)))
    found = {(m.stage, m.model): (m.value, m.unit) for m in results.metrics if "reach" in m.name}
    damping = {c.model: c.value for c in results.coefficients if c.term == "u"}
    sailed = {s.kind: s.columns["x"] for s in results.series if s.kind.startswith("deployment")}
    for model in ("nominal", "identified", "plant"):
        assert found["validation", model] == (2.0 * damping[model], "kg/s")
    for model in ("nominal", "identified"):
        x = sailed[f"deployment_{model}"]
        assert found["deployment", model] == (2.0 * np.max(np.abs(x - x[0])), "m")
    assert len(found) == 5


def test_metrics_from_elsewhere_are_a_list() -> None:
    trial = composed()
    for nodes in ("force_mse", {"_target_": "x"}):
        with pytest.raises(ConfigurationError, match=r"metrics: got .*, expected a list"):
            build_trial({**trial.config, "metrics": nodes}, trial.names)


def test_a_name_of_another_database_is_known_by_its_name_alone() -> None:
    unknown = catalogue.definition_of("of another program")
    assert (unknown.label, unknown.better, unknown.note) == ("of another program", None, "")
