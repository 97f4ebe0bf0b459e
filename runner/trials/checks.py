"""What is checked of a trial before it is run: its parts, and that they fit each other."""

import numpy as np

from seatrial.models.control.controller import Controller
from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.problem import MIN_SAMPLES, check_needs
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording, check_cutoff
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials import budget, recording_checks
from seatrial.runner.trials.closed_loop import Streams, commanded, drawn, named

MEASURED = "measured recording: plant simulation and deployment are skipped"
NOT_DEPLOYED = "no {0} ({0}=none): deployment is skipped"


def check(trial: Trial) -> None:
    """Check a trial before it is run; raises ConfigurationError for an invalid combination."""
    budget.check(trial)
    _check_commands(trial)
    trial = drawn(trial, Streams(trial.seed))
    excitation, controller = trial.excitation, trial.controller
    dofs, recording, period = trial.vessel.dofs, None, trial.sample_time_s
    with named(trial, "excitation"):
        excitation.check(dofs)
    nominal, thruster = trial.vessel.nominal(), trial.vessel.thruster
    identifier = trial.identifier
    identifier.check(nominal, thruster, isinstance(excitation, RecordedFile))
    if isinstance(excitation, RecordedFile):
        for option, path in excitation.files().items():
            if not path.exists():
                raise ConfigurationError(f"excitation.{option}: {path}: there is no such file")
        if skipped(trial) is None:
            _check_simulated(trial)
        recording = measured(trial, excitation)
        period = recording.period_s
    elif controller is None and not excitation.open_loop:
        name = trial.names["excitation"]
        raise ConfigurationError(f"controller=none: excitation={name} needs a controller")
    else:
        _check_simulated(trial)
    check_cutoff(identifier.needs().lowpass_hz, period)
    model_period = identifier.model_period_s(period)
    if controller is not None:
        controller.build(commanded(nominal, controller), trial.sample_time_s)
        if model_period and controller.takes_state_space and skipped(trial) is None:
            period = controller.command_rows(trial.sample_time_s) * trial.sample_time_s
            multiple = max(round(period / model_period), 1)
            if abs(multiple * model_period - period) > 1e-9 * period:
                raise ConfigurationError(
                    f"controller.period_s: got {period:g} s, expected a multiple of "
                    f"identifier.period_s, {model_period:g} s, at which its model is valid"
                )
    check_needs(identifier.needs(), trial.vessel.name, thruster, recording)


def skipped(trial: Trial) -> str | None:
    """Return why a trial has no deployment, or None if it has one."""
    controller, evaluation = trial.controller, trial.evaluation
    if isinstance(trial.excitation, RecordedFile):  # its reference is not known: it has no replay
        return MEASURED if controller is None or not isinstance(evaluation, Mission) else None
    if controller is None or evaluation is None:
        return NOT_DEPLOYED.format("controller" if controller is None else "evaluation")
    return evaluation.skip_reason(trial.excitation)


def evaluated(trial: Trial) -> Mission:
    """Return the mission of the evaluation, which may be that of the excitation once more."""
    evaluation, excitation = trial.evaluation, trial.excitation
    assert evaluation is not None
    if isinstance(evaluation, Mission):
        return evaluation
    assert isinstance(excitation, Mission)
    return evaluation.mission(excitation)


def measured(trial: Trial, file: RecordedFile) -> Recording:
    """Read a recording; raises RecordingError if it cannot be read, trusted, or trained on."""
    recording = file.read(trial.vessel.dofs)
    name = ", ".join(map(str, file.files().values())) or type(file).__name__
    split = file.split(recording.t, recording.file)
    if (count := int(np.count_nonzero(split.test))) < MIN_SAMPLES:
        raise RecordingError(
            f"{name}: got {count} samples for testing, expected at least {MIN_SAMPLES}"
        )
    try:
        trial.identifier.check_samples(recording.part(split.train), trial.vessel.nominal())
    except RecordingError as error:
        raise RecordingError(f"{name}: {error}") from error
    recording_checks.refuse(file, trial.vessel.dofs)
    return recording


def _check_simulated(trial: Trial) -> None:
    """Check that the vessel can carry out what is simulated, in this weather."""
    dofs, period = trial.vessel.dofs, trial.sample_time_s
    last_s, fewest = 0.0, 2 * MIN_SAMPLES
    for group in ("excitation", "evaluation"):
        if isinstance(mission := getattr(trial, group), Mission):
            seconds = mission.length().seconds
            with named(trial, group):
                if (count := round(seconds / period)) < fewest:
                    raise ConfigurationError(
                        f"got {seconds:g} s, {count} samples of sample_time_s={period:g}; "
                        f"expected at least {fewest}"
                    )
            last_s = max(last_s, mission.duration_s - period)
    with named(trial, "disturbance"):
        trial.disturbance.check(dofs, last_s)
    if isinstance(trial.excitation, Mission):
        with named(trial, "excitation"):
            trial.excitation.check_limits(trial.vessel.limits_by_dof, period)
    if trial.evaluation is not None:
        with named(trial, "evaluation"):
            trial.evaluation.check(dofs)


def _check_commands(trial: Trial) -> None:
    """Check that missions and controller command what the vessel takes: inputs, or forces."""
    vessel, controller, groups = trial.vessel, trial.controller, dict[str, Mission | Controller]()
    for group in ("excitation", "controller", "evaluation"):
        if isinstance(part := getattr(trial, group), Mission | Controller):
            groups[group] = part
    known = {bool(vessel.inputs)} | ({False} if vessel.positioning else set())
    takes = f"but {vessel.name} is commanded by {', '.join(vessel.inputs) or 'forces'}"
    for group, part in groups.items():
        with named(trial, group):
            if part.commands_inputs not in known:
                raise ConfigurationError(f"{_commands(part)}, {takes}")
    for group, part in groups.items():
        if isinstance(part, Controller) or controller is None or part.open_loop:
            continue
        with named(trial, group):
            if part.commands_inputs != controller.commands_inputs:
                other = f"controller={trial.names['controller']} {_commands(controller)}"
                raise ConfigurationError(f"{_commands(part)}, but {other}")


def _commands(part: Mission | Controller) -> str:
    return "commands inputs" if part.commands_inputs else "commands forces"
