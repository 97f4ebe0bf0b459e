"""Checks of a measured recording in a trial: warnings, and refusal of what does not agree."""

import logging
from collections.abc import Sequence

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import RecordingError
from seatrial.models.recording.consistency import LEAST_TRUSTED
from seatrial.models.recording.diagnosis import Examination, examine
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.vessel.parameters import VesselParameters

log = logging.getLogger(__name__)
MAX_EXAMINATIONS = 4  # the trials of a sweep often share a recording
_known: dict[str, Examination | None] = {}


def examined(file: RecordedFile, dofs: Sequence[str]) -> Examination | None:
    """Examine a recording; None if pose and velocity cannot be compared."""
    stamps = [path.stat().st_mtime for path in file.files().values() if path.exists()]
    if (key := repr((file, stamps, dofs))) not in _known:
        if len(_known) >= MAX_EXAMINATIONS:
            _known.pop(next(iter(_known)))
        _known[key] = examine(file, dofs)
    return _known[key]


def refuse(file: RecordedFile, dofs: Sequence[str]) -> None:
    """Raise RecordingError if an excited axis agrees with nothing and the file is not trusted."""
    known = None if file.trust else examined(file, dofs)
    for axis in known.result.untrusted if known else ():
        if known and axis.dof in dofs:
            cures = sorted(known.problems, key=lambda problem: axis.dof not in problem.axes)
            cure = f"{cures[0]}; " if cures else ""
            name = ", ".join(map(str, file.files().values()))
            raise RecordingError(
                f"{name}: {axis.dof}: got a correlation of {axis.correlation:.2f} between the "
                f"velocity and the derivative of the pose, expected {LEAST_TRUSTED} or more; "
                f"{cure}excitation.trust=true overrides"
            )


def diagnostics(file: RecordedFile, vessel: VesselParameters) -> list[Diagnostic]:
    """Warn of every problem in one line, and return what was found as diagnostics."""
    read, known = file.account(vessel.dofs), examined(file, vessel.dofs)
    left_out = dict.fromkeys(line for signals in read for line in signals.left_out)
    columns = dict.fromkeys(reading[:4] for signals in read for reading in signals.readings)
    problems = known.problems if known else ()
    for line in (*left_out, *problems):
        log.warning("recording: %s", line)
    own = [path.name for path in file.readers if any(map(path.match, vessel.regressed_on))]
    if own:
        model = f"the nominal model of vessel={vessel.name} was itself regressed on"
        log.warning("recording: %s %s: it is no stranger to them", model, ", ".join(own))
    return [
        *(Diagnostic("recording_left_out", "all", None, i=i, label=line)
          for i, line in enumerate(left_out)),
        *(Diagnostic("recording_column", "all", None, unit, i=i, label=f"{option}: {name} ({by})")
          for i, (option, name, unit, by) in enumerate(columns)),
        *(Diagnostic(f"consistency_{name}", axis.dof, getattr(axis, name))
          for axis in (known.result.axes if known else ()) for name in ("correlation", "scale")),
        *([Diagnostic("consistency_lag", "all", known.result.lag_s, "s")] if known else []),
        *(Diagnostic("recording_believed", "all", None, i=i, label=name)
          for i, name in enumerate(own)),
        *(Diagnostic(f"recording_{p.kind}", "all", p.value, i=i, label=str(p))
          for i, p in enumerate(problems)),
    ]  # fmt: skip
