"""Noise-free recordings of the exact structure: every coefficient that they excite is found.

Of the ferry, a supply vessel, a remotely operated vehicle, a tug as `seatrial init` drafts it, and
a tanker by its rudder and propeller; these two are directionally unstable. The nominal model is
wrong by a factor. The inertia of the tanker is right: a rudder acts on sway and yaw in a fixed
proportion, so that any multiple of one equation may be added to the other. A fit of free runs,
whose inertia is free, has no data that tell which: the prior decides.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from seatrial.models.identification.auto import identified
from seatrial.models.identification.problem import Problem
from seatrial.models.vessel.basis import evaluate
from seatrial.models.vessel.table import Vessel
from seatrial.runner.commands.init import draft_vessel
from seatrial.runner.configuration.config import Trial, build_trial
from seatrial.runner.configuration.vessel_options import filled
from seatrial.runner.record.vocabulary import GROUPS
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.trial import excite
from tests.trials import CONF

RECORDINGS = {
    "milliampere": (),
    "supply_vessel": (),
    "tug": (),
    "beluga_linear": ("excitation=multisine", "controller=none"),
    "kvlcc2": ("excitation=rudder_prbs", "controller=none"),
}
IDENTIFIERS = {"ls": 1e-3, "iv": 1e-3, "output_error": 1e-3, "robust": 5e-3, "auto": 5e-3}
SCALE = 0.8  # of the true coefficients over the nominal ones
EXCITED = 1e-2  # share of the force of an axis, from which a term is to be found


@cache
def trial(vessel: str, identifier: str) -> Trial:
    """A trial in calm water; the vessel may be one that `init` drafts."""
    known = (CONF / "vessel" / f"{vessel}.yaml").is_file()
    overrides = (*RECORDINGS[vessel], "disturbance=calm", f"identifier={identifier}")
    with initialize_config_dir(str(CONF), version_base="1.3"):
        name = vessel if known else "milliampere"
        config = compose("trial", [f"vessel={name}", *overrides], return_hydra_config=True)
        choices = dict(config.hydra.runtime.choices)
        OmegaConf.set_struct(config, False)
        del config["hydra"]
        if not known:
            text = draft_vessel(vessel, {"length": 6.0, "mass": 4000.0})
            config.vessel = yaml.safe_load(text)
        nodes = OmegaConf.to_container(config, resolve=True)
    named = {group: choices[group] for group in GROUPS}
    return build_trial(filled({str(key): node for key, node in nodes.items()}), named)


@cache
def recorded(vessel: str) -> tuple[Problem, Vessel]:
    """A problem with a wrong nominal model, and the truth."""
    own = trial(vessel, "ls")
    data = excite(own, Streams(0))
    training, testing = (data.recording.part(mask) for mask in (data.training, data.testing))
    truth = data.truth
    inertial = np.isin([term.name for term in truth.terms], truth.accelerations)
    kept = inertial & bool(truth.inputs)
    nominal = replace(truth, theta=truth.theta / np.where(kept, 1.0, SCALE)[:, None])
    return Problem(training, testing, nominal, own.vessel.thruster), truth


def excited(problem: Problem, truth: Vessel) -> np.ndarray:
    """Entries of the table whose term is a share of the force of its axis."""
    recording = problem.training
    phi = evaluate(truth.terms, recording.variables())
    force = np.max(np.std(phi, axis=0)[:, None] * np.abs(truth.theta), axis=0)
    return np.std(phi, axis=0)[:, None] * np.abs(truth.theta) > EXCITED * force


@pytest.mark.slow
@pytest.mark.parametrize("identifier", IDENTIFIERS)
@pytest.mark.parametrize("vessel", RECORDINGS)
def test_what_the_data_excite_is_found(vessel: str, identifier: str) -> None:
    problem, truth = recorded(vessel)
    if truth.inputs and identifier not in ("ls", "iv"):
        pytest.skip("free runs identify the inertia too")
    options = trial(vessel, identifier).identifier
    if truth.inputs:  # by default its terms are others
        terms = (term.name for term in truth.terms if term.name not in truth.accelerations)
        options = replace(options, basis=tuple(terms))
    found = identified(options, problem, np.random.default_rng(0))
    shown = excited(problem, truth)
    error = found.model.on(truth.terms).theta / np.where(truth.theta == 0.0, 1.0, truth.theta)
    assert np.count_nonzero(shown) >= len(truth.dofs)
    np.testing.assert_allclose(error[shown], 1.0, atol=IDENTIFIERS[identifier])
