"""What is checked of a trial before it is run: its parts, and that they fit each other."""

from collections.abc import Callable

import numpy as np

from seatrial.models.control.controller import Controller
from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.problem import MIN_SAMPLES, check_needs
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording, check_cutoff
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials import budget, recording_checks
from seatrial.runner.trials.closed_loop import Streams, commanded, drawn

MEASURED = "measured recording: plant simulation and deployment are skipped"
NOT_DEPLOYED = "no {0} ({0}=none): deployment is skipped"


def check(trial: Trial) -> None:
    """Check a trial before it is run; raises ConfigurationError for an invalid combination."""
    budget.check(trial)
    _check_commands(trial)
    trial = drawn(trial, Streams(trial.seed))
    excitation, dofs = trial.excitation, trial.vessel.dofs
    named(trial, "excitation", lambda: excitation.check(dofs))
    nominal, thruster = trial.vessel.nominal(), trial.vessel.thruster
    trial.identifier.check(nominal, thruster, isinstance(excitation, RecordedFile))
    recording, period = None, trial.sample_time_s
    if isinstance(excitation, RecordedFile):
        for option, path in excitation.files().items():
            if not path.exists():
                raise ConfigurationError(f"excitation.{option}: {path}: there is no such file")
        if skipped(trial) is None:
            evaluation = trial.evaluation
            assert isinstance(evaluation, Mission)
            _check_length(trial, "evaluation", evaluation)
            named(trial, "disturbance", lambda: trial.disturbance.check(dofs, longest_s(trial)))
            named(trial, "evaluation", lambda: evaluation.check(dofs))
        recording = measured(trial, excitation)
        period = recording.period_s
    else:
        _check_mission(trial, excitation)
    needs = trial.identifier.needs()
    check_cutoff(needs.lowpass_hz, period)
    model_period = trial.identifier.model_period_s(period)
    controller = trial.controller
    if controller is not None:
        controller.build(commanded(nominal, controller), trial.sample_time_s)
        if model_period is not None and skipped(trial) is None:
            check_periods(trial, controller, model_period)
    check_needs(needs, trial.vessel.name, thruster, recording)


def skipped(trial: Trial) -> str | None:
    """Return why a trial has no deployment, or None if it has one."""
    if isinstance(
        trial.excitation, RecordedFile
    ):  # its reference is not known, so it has no replay
        missing = trial.controller is None or not isinstance(trial.evaluation, Mission)
        return MEASURED if missing else None
    if trial.controller is None:
        return NOT_DEPLOYED.format("controller")
    if trial.evaluation is None:
        return NOT_DEPLOYED.format("evaluation")
    return trial.evaluation.skip_reason(trial.excitation)


def measured(trial: Trial, file: RecordedFile) -> Recording:
    """Read a recording; raises RecordingError if it cannot be read, trusted, or trained on."""
    recording = file.read(trial.vessel.dofs)
    _check_samples(trial, file, recording)
    recording_checks.refuse(file, trial.vessel.dofs)
    return recording


def _check_samples(trial: Trial, file: RecordedFile, recording: Recording) -> None:
    """Check that a recording has enough samples to train and to test; raises RecordingError."""
    name = ", ".join(map(str, file.files().values())) or type(file).__name__
    split = file.split(recording.t, recording.file)
    if (count := int(np.count_nonzero(split.test))) < MIN_SAMPLES:
        raise RecordingError(
            f"{name}: got {count} samples for testing, expected at least {MIN_SAMPLES}"
        )
    training, nominal = recording.part(split.train), trial.vessel.nominal()
    try:
        trial.identifier.check_samples(training, nominal)
    except RecordingError as error:
        raise RecordingError(f"{name}: {error}") from error


def _check_mission(trial: Trial, excitation: Mission) -> None:
    """Check that the vessel and the controller can carry out the mission in this weather."""
    dofs = trial.vessel.dofs
    if trial.controller is None and not excitation.open_loop:
        raise ConfigurationError(
            f"controller=none: excitation={trial.names['excitation']} needs a controller"
        )
    for group, mission in (("excitation", excitation), ("evaluation", trial.evaluation)):
        if isinstance(mission, Mission):
            _check_length(trial, group, mission)
    named(trial, "disturbance", lambda: trial.disturbance.check(dofs, longest_s(trial)))
    named(
        trial, "excitation",
        lambda: excitation.check_limits(trial.vessel.limits_by_dof, trial.sample_time_s),
    )  # fmt: skip
    evaluation = trial.evaluation
    if evaluation is not None:
        named(trial, "evaluation", lambda: evaluation.check(dofs))


def _check_commands(trial: Trial) -> None:
    """Check that missions and controller command what the vessel takes: inputs, or forces."""
    vessel = trial.vessel
    takes = ", ".join(vessel.inputs) or "forces"
    kinds = {True: "inputs", False: "forces"}
    known = {bool(vessel.inputs)} | ({False} if vessel.positioning else set())
    for group, part in (
        ("excitation", trial.excitation),
        ("controller", trial.controller),
        ("evaluation", trial.evaluation),
    ):
        if isinstance(part, Mission | Controller) and part.commands_inputs not in known:
            raise ConfigurationError(
                f"{group}={trial.names[group]}: commands {kinds[part.commands_inputs]}, "
                f"but {vessel.name} is commanded by {takes}"
            )
    controller = trial.controller
    for group in ("excitation", "evaluation"):
        mission = getattr(trial, group)
        if controller is None or not isinstance(mission, Mission) or mission.open_loop:
            continue
        if mission.commands_inputs != controller.commands_inputs:
            raise ConfigurationError(
                f"{group}={trial.names[group]}: commands {kinds[mission.commands_inputs]}, but "
                f"controller={trial.names['controller']} commands "
                f"{kinds[controller.commands_inputs]}"
            )


def _check_length(trial: Trial, group: str, mission: Mission) -> None:
    """Check that a mission has samples for training and for testing."""
    seconds, period = mission.length().seconds, trial.sample_time_s
    count, fewest = round(seconds / period), 2 * MIN_SAMPLES
    if count < fewest:
        raise ConfigurationError(
            f"{group}={trial.names[group]}: got {seconds:g} s, {count} samples of"
            f" sample_time_s={period:g}; expected at least {fewest}"
        )


def named(trial: Trial, group: str, check: Callable[[], None]) -> None:
    """Run a check, and put the option chosen from the group before its error message."""
    try:
        check()
    except ConfigurationError as error:
        name = f"{group}={trial.names[group]}"
        if str(error).startswith(name):
            raise
        raise ConfigurationError(f"{name}: {error}") from error


def longest_s(trial: Trial) -> float:
    """Return the time [s] of the last simulated instant, of the excitation or the evaluation."""
    missions = (trial.excitation, trial.evaluation)
    durations = [mission.duration_s for mission in missions if isinstance(mission, Mission)]
    return max(durations) - trial.sample_time_s if durations else 0.0


def check_periods(trial: Trial, controller: Controller, model_period: float) -> None:
    """Check that the controller's period is a multiple of the identified model's period [s]."""
    if not controller.takes_state_space:
        return
    sample_time = trial.sample_time_s
    period = controller.command_rows(sample_time) * sample_time
    multiple = round(period / model_period)
    if multiple < 1 or abs(multiple * model_period - period) > 1e-9 * period:
        raise ConfigurationError(
            f"controller.period_s: got {period:g} s, expected a multiple of identifier.period_s, "
            f"{model_period:g} s: a state-space model is valid at its own sample time only"
        )
