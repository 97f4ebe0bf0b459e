"""The size of a trial and of a sweep, computed from the configuration before any work.

A trial is as large as the longest of its simulations, a sweep as large as the number of its trials.
Counts of repetitions, such as bootstrap replicates, are bounded where they are declared.
"""

import os
from collections.abc import Sequence
from math import ceil, prod

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.missions import Mission
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.runner.configuration.config import Limits, Trial

SHARE = 0.8  # of the machine's memory, if the limit is not set
RECORDED = 400.0  # bytes for each sample and degree of freedom, in the recording and its residuals
TEXT = 10.0  # bytes of memory for each byte of a measured file


def check(trial: Trial) -> None:
    """Raise ConfigurationError if a trial simulates too many samples or takes too much memory."""
    limits, period = trial.limits, trial.sample_time_s
    most = _memory() if limits.memory is None else limits.memory * 1e9
    steps = ceil(max(1.0, period / trial.integration_step_s))
    for group in ("excitation", "evaluation"):
        mission = getattr(trial, group)
        if not isinstance(mission, Mission):
            continue
        length = mission.length()
        samples = length.seconds / period
        got = (
            f"{group}.{length.option}: got {length.got:g}, {samples:.2g} samples of "
            f"sample_time_s={period:g} with {steps:.2g} steps of "
            f"integration_step_s={trial.integration_step_s:g} each"
        )
        if samples * steps > limits.samples:
            raise ConfigurationError(
                f"{got}; expected at most {limits.samples:.2g} steps (limits.samples)"
            )
        _check_memory(got, RECORDED * samples * len(trial.vessel.dofs), most)
    if isinstance(trial.excitation, RecordedFile):
        for option, path in trial.excitation.files().items():
            size = path.stat().st_size if path.is_file() else 0
            _check_memory(f"excitation.{option}: got {path}, a file", TEXT * size, most)


def _check_memory(got: str, memory: float, most: float) -> None:
    if memory > most:
        raise ConfigurationError(
            f"{got} of about {memory / 1e9:.2g} GB in memory; "
            f"expected at most {most / 1e9:.2g} GB (limits.memory)"
        )


def _memory() -> float:
    """Return the share of the machine's memory [bytes]; infinite if the system does not say."""
    if not hasattr(os, "sysconf"):
        return float("inf")
    return SHARE * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def check_sweep(values: Sequence[tuple[str, float]], limits: Limits, before: int = 0) -> None:
    """Raise ConfigurationError for a grid of more trials than the limit.

    Args:
        values: the options and the number of values of each.
        limits: the limits of the sweep.
        before: the number of trials of other grids.
    """
    count = before + prod((number for _, number in values), start=1.0)
    if count > limits.trials:
        option, number = max(values, key=lambda item: item[1])
        raise ConfigurationError(
            f"{option}: got {number:g} values, {count:g} trials; "
            f"expected at most {limits.trials:g} (limits.trials)"
        )
