"""What tables and figures are made of: runs, and one number of a run each.

A *factor* is a name that rows, columns or facets go by: a column of table `run`, a dotted key of
the configuration, or a property of the number itself (model, dof, stage, metric).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

OWN_FACTORS = ("metric", "stage", "model", "dof")  # what the number, not its run, says
BELOW_TRUE_MODEL = "below_true_model"
DESIGN_FLAWS = ("spectral_radius", "infeasible_limits")  # of a controller, where 1 or more
FINISHED = "finished"


@dataclass(frozen=True, slots=True)
class Run:
    """A stored run; `levels` are its choices, its seed and the factors asked for, as text."""

    id: int
    status: str  # running, finished, diverged, failed or interrupted
    levels: Mapping[str, str] = field(repr=False)
    sweep: int | None = None


@dataclass(frozen=True, slots=True)
class Observation:
    """One number of a run: a metric, or (stage `coefficient`) a coefficient named by its term."""

    run: Run
    stage: str
    model: str
    dof: str
    name: str
    value: float | None
    unit: str
    std_error: float | None = None
    true_value: float | None = None

    def level(self, factor: str) -> str:
        """The value of a factor, as text."""
        match factor:
            case "metric":
                return self.name
            case "stage":
                return self.stage
            case "model":
                return self.model
            case "dof":
                return self.dof
            case _:
                return self.run.levels[factor]


def ordered(levels: Iterable[str]) -> list[str]:
    """Distinct levels in reading order: numbers by size, then `none`, then text."""
    return sorted(set(levels), key=_reading_order)


def _reading_order(level: str) -> tuple[int, float, str]:
    try:
        return 0, float(level), level
    except ValueError:
        return (1 if level in ("none", "calm", "nominal") else 2), 0.0, level
