"""Names that the configuration, the database and the comparison share."""

from collections.abc import Mapping
from typing import Any, Literal, TypeAlias, get_args

from seatrial.models.diagnostics import TRAINING_TIME as TRAINING_TIME
from seatrial.models.notation import DOFS as DOFS
from seatrial.models.notation import POSES as POSES

# A configuration, or a part of it, as read from YAML or from the logbook: plain values by name.
Config: TypeAlias = Mapping[str, Any]

# Groups of options; a run stores the option chosen from each group.
GROUPS = ("vessel", "disturbance", "excitation", "identifier", "controller", "evaluation")

# Options of where results are stored and how a trial is started: they do not change the results.
NOT_COMPARED = ("results_dir", "database", "rerun", "dry_run", "limits", "sweep")

Stage = Literal["identification", "validation", "deployment"]  # of a trial, as its metrics name it
# Beginnings of options that change no result.
NO_RESULT = ("results_dir=", "sweep.", "hydra", "database", "dry_run=", "rerun=")
SAILED = ("nominal", "identified")  # models that controllers know, before and after
MODELS = ("mean_motion", "nominal", "identified", "plant", "residual")

# Independent random streams of a trial, in the order in which its seed spawns them.
Stream = Literal["excitation", "noise", "disturbance", "identifier", "evaluation"]
STREAMS: tuple[Stream, ...] = get_args(Stream)

# Values of `dof` for several degrees of freedom, and all values in the order of tables.
COMBINED = ("position", "heading", "all")
DOF_ORDER = (*DOFS, *COMBINED)

UNPHYSICAL = "unphysical"  # diagnostic: why a model is physically impossible
OF_FILE = "file_"  # begins the name of a diagnostic that is a metric of one of several files

Ending = Literal["finished", "diverged", "failed"]  # of a run that has ended
ENDINGS: tuple[Ending, ...] = get_args(Ending)
IDENTIFIED_STD = "identified_std"  # ends the columns of the bands in the series `prediction`
STATUSES = ("running", *ENDINGS, "interrupted")  # of a run; interrupted: its process was lost
NOT_STARTED = "not started"  # of a planned trial that has no run
UNFINISHED = ("failed", "diverged", "running", "interrupted", NOT_STARTED)
LOST = ("failed", "diverged", "interrupted")  # what `retry` runs again
