"""The budget of a trial: what its options take, against the limits of work and of memory.

Every part states its own demands (seatrial.models.demand). Here they are added up and judged,
before a recording is simulated, read or resampled.
"""

import os
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import accumulate
from math import ceil, log, prod
from pathlib import Path
from time import monotonic

from seatrial.models.demand import Demand, Extent, amount
from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.missions import Length, Mission
from seatrial.models.recording.readers import Reader
from seatrial.runner.config import Limits, Trial

SHARE = 0.8  # of the available memory, if the limit is not set
RECORDED = 400.0  # bytes for each sample and degree of freedom, in the recording and its residuals
TEXT = 10.0  # bytes of memory for each byte of a CSV file
USUAL = {"length": 1e3, "sample_time_s": 0.1, "integration_step_s": 0.025}  # [s]
BYTES = ("B", "kB", "MB", "GB", "TB", "PB", "EB")
SHOWN = 1e9  # bytes, from which the memory is named where the work is too large
RUN_FILES = 6  # largest number of series files of a run


def check(trial: Trial, recorded: int | None = None) -> None:
    """Raise ConfigurationError if a trial takes more work or memory than its limits allow.

    `recorded` is the number of samples of a measured recording, once it has been read.
    """
    judge(list(demands(trial, recorded)), trial.limits)


def judge(demands: Sequence[Demand], limits: Limits) -> None:
    """Raise ConfigurationError if the sum of demands exceeds a limit.

    Later demands may follow from earlier ones, such as a bootstrap from the length of a recording.
    So they are added one by one, and the largest of those before the limit is passed is named.
    """
    works = list(accumulate(demand.samples for demand in demands))
    memories = list(accumulate(demand.memory for demand in demands))
    most = SHARE * _available_in(int(monotonic())) if limits.memory is None else limits.memory * 1e9
    for i, (work, memory) in enumerate(zip(works, memories, strict=True)):
        if work > limits.samples:
            largest = max(demands[: i + 1], key=lambda demand: demand.samples)
            limit = f"{amount(limits.samples)} samples of work (limits.samples)"
            raise ConfigurationError(_message(largest, f"{amount(work)} samples of work", limit))
        if memory > most:
            largest = max(demands[: i + 1], key=lambda demand: demand.memory)
            raise ConfigurationError(_message(largest, "", f"{in_bytes(most)} (limits.memory)"))


def _message(demand: Demand, work: str, limit: str) -> str:
    memory = in_bytes(demand.memory) if demand.memory > SHOWN or not work else ""
    takes = ", ".join(filter(None, (demand.detail, work, memory)))
    return f"{demand.option}: got {demand.got}, {takes}; expected at most {limit}"


def demands(trial: Trial, recorded: int | None = None) -> Iterable[Demand]:
    """All that a trial takes; `recorded` are the samples of a measured recording."""
    excitation, period = trial.excitation, trial.sample_time_s
    if isinstance(excitation, Mission):
        samples = excitation.length().seconds / period
        yield from sailed(trial, "excitation", excitation, 1)
        evaluation = None if trial.controller is None else trial.evaluation
        if evaluation is not None and evaluation.skip_reason(excitation) is None:
            mission = evaluation.mission(excitation)
            group = "excitation" if mission is excitation else "evaluation"
            yield from sailed(trial, group, mission, 2 if trial.update is None else 3)
    elif isinstance(excitation, Reader):
        if recorded is None:
            for option, path in excitation.files().items():
                yield file_demand(f"excitation.{option}", path)
            return
        samples = float(recorded)
        if trial.controller is not None and isinstance(trial.evaluation, Mission):
            voyages = 2 if trial.update is None else 3
            yield from sailed(trial, "evaluation", trial.evaluation, voyages)
    for demand in trial.identifier.demands(_extent(trial, samples)):
        yield demand.of("identifier")


def _extent(trial: Trial, samples: float) -> Extent:
    nominal = trial.vessel.nominal()
    return Extent(samples, trial.sample_time_s, len(nominal.dofs), len(nominal.terms))


def sailed(trial: Trial, group: str, mission: Mission, voyages: int) -> Iterable[Demand]:
    """The simulations of a mission, which is an option of `group`."""
    length, period = mission.length(), trial.sample_time_s
    samples = length.seconds / period
    extent = _extent(trial, samples)
    yield _simulated(trial, group, length, voyages)
    if group != "excitation" or voyages == 1:
        yield from (demand.of(group, voyages) for demand in mission.demands(period))
    if trial.controller is not None and not mission.open_loop:
        yield from (demand.of("controller", voyages) for demand in trial.controller.demands(extent))
    if trial.update is not None and voyages > 1:
        yield from (demand.of("update") for demand in trial.update.demands(extent))


def _simulated(trial: Trial, group: str, length: Length, voyages: int) -> Demand:
    """The integration of a mission; of its three options the least usual one is named."""
    period, step = trial.sample_time_s, trial.integration_step_s
    samples, substeps = length.seconds / period, max(1.0, period / step)
    unusual = {
        f"{group}.{length.option}": log(max(length.seconds, 1e-300) / USUAL["length"]),
        "sample_time_s": log(USUAL["sample_time_s"] / period),
        "integration_step_s": log(USUAL["integration_step_s"] / step),
    }
    option = max(unusual, key=lambda name: unusual[name])
    got = {"sample_time_s": period, "integration_step_s": step}.get(option, length.got)
    unit = " s" if option.endswith("_s") else ""
    detail = f"{amount(samples)} samples of {period:g} s"
    if option == "integration_step_s":
        detail = f"{amount(samples * substeps)} steps in {length.seconds:g} s"
    memory = RECORDED * samples * len(trial.vessel.dofs)
    return Demand(option, f"{got:g}{unit}", detail, voyages * samples * ceil(substeps), memory)


def file_demand(option: str, path: Path) -> Demand:
    """The memory to read a file; its samples are not known yet."""
    size = float(path.stat().st_size) if path.is_file() else 0.0
    return Demand(option, path, f"a file of {in_bytes(size)}", 0.0, TEXT * size)


def check_sweep(values: Sequence[tuple[str, float]], limits: Limits, before: int = 0) -> None:
    """Raise ConfigurationError for a grid of more trials than the limit.

    `values` are the options and the number of values of each, `before` the trials of other grids.
    """
    count = before + prod((number for _, number in values), start=1.0)
    if count > limits.trials:
        option, number = max(values, key=lambda item: item[1])
        raise ConfigurationError(
            f"{option}: got {amount(number)} values, {amount(count)} trials with up to "
            f"{amount(RUN_FILES * count)} files; expected at most {amount(limits.trials)} trials "
            f"(limits.trials)"
        )


@lru_cache(maxsize=1)
def _available_in(_second: int) -> float:
    """`available_bytes`, asked once in a second: a sweep judges very many trials."""
    return available_bytes()


def available_bytes() -> float:
    """The memory that this process can still take; infinite if the system does not say."""
    sizes = [_system_bytes(), _group_bytes(Path("/sys/fs/cgroup"))]
    return min(sizes)


def _system_bytes() -> float:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
    except OSError:
        pass
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return float("inf")


def _group_bytes(folder: Path) -> float:
    """What the control group of a container leaves."""
    try:
        most, used = ((folder / f"memory.{name}").read_text() for name in ("max", "current"))
        return float(most) - float(used)  # `max`: no limit
    except (OSError, ValueError):
        return float("inf")


def in_bytes(size: float) -> str:
    """A size in the unit that leaves one to three digits before the point, as in `2.3 PB`."""
    unit = 0
    while size >= 1e3 and unit < len(BYTES) - 1:
        size, unit = size / 1e3, unit + 1
    return f"{size:.2g} {BYTES[unit]}" if size < 100 else f"{amount(size)} {BYTES[unit]}"
