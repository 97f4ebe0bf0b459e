"""Identification while sailing: the model is replaced when the controller has too much to correct.

Jervan (2020), section 3.4 and figure 3.5, leaves it to future work: "an increasing inaccuracy in
the model, triggered by a large residual or the feedback controller having to compensate more".
Improving again is addition: F_{i+1} = F_i + what is identified of its residual over a window. A
candidate must explain the end of its window, which it was not fitted to, better than its
predecessor, and the whole past better than no model at all: a window that does not excite a
coefficient must not let it run away. The controller takes it over without a bump.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.problem import Identifier, Problem, lack_of_fit
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.loop import Watch
from seatrial.models.simulation.registry import Parameters, State
from seatrial.models.simulation.voyage import Log, Voyage, recording_of
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.weather.weather import Weather

TINY = 1e-300  # a force of nothing
HELD_OUT = 0.25  # of a window, its end: what a candidate is judged on


@dataclass(frozen=True)
class Update:
    """When to identify again, and on how much.

    Every `every_s` the last `window_s` are looked at, once so many have passed since the last
    update. `feedback`: the feedback's share of the command, `residual`: the rms of the lack of fit
    over that of the force; the largest of the axes against `threshold`. `lowpass_hz` takes the
    noise out of what is looked at (the identifier has its own).
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
    """Watches a voyage, identifies, and changes the controller; keeps every version of the model.

    `adapt(parameters, state, model, log, k)` gives the controller's parameters for a new model.
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
        """What the simulation calls."""
        return Watch(max(1, round(self.update.every_s / self.period_s)), self.look)

    def look(self, k: int, log: Log, parameters: Parameters, state: State) -> Parameters:
        """Parameters for a better model, where the trigger asks for one and there is one."""
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
        )
        try:
            candidate = self.identifier.identify(problem, self.rng).model
            candidate.plant_table()  # an inertia that cannot be solved is no model
        except (IdentificationError, ConfigurationError) as error:
            self.refused.append((k * self.period_s, str(error)))
            return parameters
        why = self._against(candidate, problem.validation, recording)
        if why is not None:
            self.refused.append((k * self.period_s, why))
            return parameters
        self.model = candidate
        self.versions.append((k * self.period_s, candidate, size))
        return self.adapt(parameters, state, candidate, log, k)

    def _recording(self, k: int, log: Log) -> Recording:
        """What was measured before the instant k."""
        past = Log(*(values[:k] for values in log))
        met = Weather(*(values[:k] for values in self.weather))
        t = self.period_s * np.arange(k, dtype=np.float64)
        voyage = Voyage(t, past, self.dofs, met)
        return recording_of(voyage, met).with_thruster(self.thruster)

    def _trigger(self, log: Log, recording: Recording, window: int) -> float:
        """The largest share over the axes; quiet axes count by what they did before."""
        smooth = recording.lowpass(self.update.lowpass_hz)
        if self.update.trigger == "feedback":
            commands = replace(recording, tau=log.tau_fb[: len(recording)])
            part, whole = commands.lowpass(self.update.lowpass_hz).tau, smooth.tau
        else:
            part, whole = lack_of_fit(smooth, self.model, None), smooth.force(None)
        share, recent, ever = (
            np.sqrt(np.mean(np.square(values), axis=0))
            for values in (part[-window:], whole[-window:], whole)
        )
        return float(np.max(share / np.maximum(np.maximum(recent, ever), TINY)))

    def _against(self, candidate: Vessel, held_out: Recording, past: Recording) -> str | None:
        """What speaks against a candidate, or None; axes together, each relative to its force."""
        last, whole = (one.lowpass(self.update.lowpass_hz) for one in (held_out, past))
        if not _misfit(candidate, last) < _misfit(self.model, last):
            return "it explains the window's end no better"
        if not _misfit(candidate, whole) < _misfit(0.0 * candidate, whole):
            return "it explains the whole past no better than no model"
        return None

    def findings(self) -> list[Finding]:
        """When the model was replaced, by what trigger, and when a candidate was refused."""
        found = []
        for i, (time, _, size) in enumerate(self.versions, start=1):
            found.append(Finding("update", "all", time, "s", i=i, label="adaptive"))
            found.append(Finding("update_trigger", "all", size, i=i, label=self.update.trigger))
        for i, (time, why) in enumerate(self.refused, start=1):
            found.append(Finding("update_refused", "all", time, "s", i=i, label=why))
        return found


def _misfit(model: Vessel, recording: Recording) -> float:
    """Mean over the axes of the residual's share of the force's mean square."""
    variance = np.mean(np.square(recording.force(None)), axis=0)
    error = np.mean(np.square(lack_of_fit(recording, model, None)), axis=0)
    return float(np.mean(error / np.maximum(variance, TINY)))
