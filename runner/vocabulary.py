"""Names that the configuration, the database and the comparison share, each declared once."""

from typing import Literal, get_args

from seatrial.models.notation import DOFS

# Groups of options; a run stores which option of each was chosen.
GROUPS = ("vessel", "disturbance", "excitation", "identifier", "controller", "evaluation")

Stage = Literal["identification", "validation", "deployment"]  # of a trial, as its metrics name it
MODELS = ("nominal", "identified", "plant", "residual")

# Values of `dof` that stand for several degrees of freedom, and all values in reading order.
COMBINED = ("position", "heading", "all")
DOF_ORDER = (*DOFS, *COMBINED)

Ending = Literal["finished", "diverged", "failed"]  # of a trial that was run to its end
ENDINGS: tuple[Ending, ...] = get_args(Ending)
STATUSES = ("running", *ENDINGS, "interrupted")  # of a run; interrupted: its process was lost
UNFINISHED = ("failed", "diverged", "running", "interrupted")
LOST = ("failed", "diverged", "interrupted")  # what `retry` runs again
