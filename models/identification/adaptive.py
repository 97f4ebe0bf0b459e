"""Adaptive identification: the model is replaced when the feedback has to correct too much.

Jervan (2020), section 3.4 and figure 3.5, leaves it to future work: "an increasing inaccuracy in
the model, triggered by a large residual or the feedback controller having to compensate more".
The new model is F_{i+1} = F_i + the residual identified over a window. A candidate must explain
the end of its window, to which it was not fitted, better than its predecessor, and the whole past
better than a model of zero force: otherwise a coefficient that the window does not excite could
take any value. The controller changes to the new model without a bump.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.problem import Identifier, Problem, lack_of_fit
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.loop import Watch
from seatrial.models.simulation.registry import Parameters, State
from seatrial.models.simulation.voyage import Log, Voyage, recording_of
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.weather.weather import Weather

TINY = 1e-300  # avoids division by a force of zero
HELD_OUT = 0.25  # last part of a window, on which a candidate is validated


@dataclass(frozen=True)
class Update:
    """When the model is identified again, and over which window.

    Every `every_s` [s] the last `window_s` [s] are checked, if at least `window_s` has passed since
    the last update. The trigger `feedback` is the rms of the feedback divided by the rms of the
    command, `residual` the rms of the lack of fit divided by the rms of the force; the largest over
    the axes is compared with `threshold`. `lowpass_hz` filters the signals of the trigger (the
    identifier has its own filter).
    """

    window_s: Positive
    every_s: Positive
    trigger: Literal["feedback", "residual"]
    threshold: Positive
    lowpass_hz: float | None

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(eq=False)
class Adapter:
    """Identify the model again during a simulation and update the controller.

    `adapt(parameters, state, model, log, k)` returns the controller's parameters for a new model.
    All versions of the model and all rejected candidates are stored.
    """

    update: Update
    identifier: Identifier
    thruster: SecondOrderLag | None
    weather: Weather
    dofs: tuple[str, ...]
    period_s: float
    model: Vessel
    rng: np.random.Generator
    adapt: Callable[[Parameters, State, Vessel, Log, int], Parameters]
    versions: list[tuple[float, Vessel, float]] = field(
        default_factory=list
    )  # time, model, trigger
    refused: list[tuple[float, str]] = field(default_factory=list)  # time, why
    _since: int = 0

    @property
    def watch(self) -> Watch:
        """The callback of the simulation."""
        return Watch(max(1, round(self.update.every_s / self.period_s)), self.look)

    def look(self, k: int, log: Log, parameters: Parameters, state: State) -> Parameters:
        """Parameters for a new model if the trigger fires and the candidate passes."""
        window = round(self.update.window_s / self.period_s)
        if k - self._since < window:
            return parameters
        recording = self._recording(k, log)
        size = self._trigger(log, recording, window)
        if size <= self.update.threshold:
            return parameters
        self._since = k
        cut = k - round(HELD_OUT * window)
        problem = Problem(
            training=recording.part(slice(k - window, cut)),
            validation=recording.part(slice(cut, k)),
            nominal=self.model,
            thruster=self.thruster,
            compared=True,  # it is judged below, on the end of the window
        )
        try:
            candidate = self.identifier.identify(problem, self.rng).model
            candidate.plant_table()  # raises for a singular inertia
        except (IdentificationError, ConfigurationError) as error:
            self.refused.append((k * self.period_s, str(error)))
            return parameters
        reason = self._rejection_reason(candidate, problem.validation, recording)
        if reason is not None:
            self.refused.append((k * self.period_s, reason))
            return parameters
        self.model = candidate
        self.versions.append((k * self.period_s, candidate, size))
        return self.adapt(parameters, state, candidate, log, k)

    def _recording(self, k: int, log: Log) -> Recording:
        """The recording of the samples before instant k."""
        past = Log(*(values[:k] for values in log))
        weather = Weather(*(values[:k] for values in self.weather))
        t = self.period_s * np.arange(k, dtype=np.float64)
        voyage = Voyage(t, past, self.dofs, weather, self.dofs if self.thruster is None else ())
        return recording_of(voyage, weather).with_thruster(self.thruster)

    def _trigger(self, log: Log, recording: Recording, window: int) -> float:
        """The largest ratio over the axes, with the larger of the recent and the overall rms."""
        smooth = recording.lowpass(self.update.lowpass_hz)
        if self.update.trigger == "feedback":
            commands = replace(recording, tau=log.tau_fb[: len(recording)])
            numerator, denominator = commands.lowpass(self.update.lowpass_hz).tau, smooth.tau
        else:
            numerator, denominator = lack_of_fit(smooth, self.model, None), smooth.force(None)
        recent_numerator, recent_denominator, overall = (
            np.sqrt(np.mean(np.square(values), axis=0))
            for values in (numerator[-window:], denominator[-window:], denominator)
        )
        return float(
            np.max(recent_numerator / np.maximum(np.maximum(recent_denominator, overall), TINY))
        )

    def _rejection_reason(
        self, candidate: Vessel, held_out: Recording, past: Recording
    ) -> str | None:
        """Why a candidate is rejected, or None if it passes."""
        window_end, history = (
            recording.lowpass(self.update.lowpass_hz) for recording in (held_out, past)
        )
        if not _misfit(candidate, window_end) < _misfit(self.model, window_end):
            return "the candidate does not explain the end of the window better than the last model"
        if not _misfit(candidate, history) < _misfit(0.0 * candidate, history):
            return "the candidate does not explain the whole past better than zero force"
        return None

    def diagnostics(self) -> list[Diagnostic]:
        """Times of the model updates with their triggers, and times of the rejected candidates."""
        rows = []
        for i, (time, _, size) in enumerate(self.versions, start=1):
            rows.append(Diagnostic("update", "all", time, "s", i=i, label="adaptive"))
            rows.append(Diagnostic("update_trigger", "all", size, i=i, label=self.update.trigger))
        for i, (time, reason) in enumerate(self.refused, start=1):
            rows.append(Diagnostic("update_refused", "all", time, "s", i=i, label=reason))
        return rows


def _misfit(model: Vessel, recording: Recording) -> float:
    """Mean square of the residual divided by that of the force, averaged over the axes."""
    variance = np.mean(np.square(recording.force(None)), axis=0)
    error = np.mean(np.square(lack_of_fit(recording, model, None)), axis=0)
    return float(np.mean(error / np.maximum(variance, TINY)))
