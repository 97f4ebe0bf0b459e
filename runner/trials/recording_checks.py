"""Checks of a measured recording in a trial: warnings, and refusal of what does not agree."""

import logging
from collections.abc import Sequence
from contextlib import suppress

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import RecordingError
from seatrial.models.recording.consistency import LEAST_TRUSTED
from seatrial.models.recording.diagnosis import Examination, examine
from seatrial.models.recording.recorded_file import RecordedFile

log = logging.getLogger(__name__)
TRUST = "excitation.trust=true overrides"
MAX_EXAMINATIONS = 4  # examinations: the trials of a sweep often share a recording
_known: dict[tuple[object, ...], Examination | None] = {}


def examined(file: RecordedFile, dofs: Sequence[str]) -> Examination | None:
    """Examine a recording; None if pose and velocity cannot be compared."""
    stamps = []
    for path in file.files().values():
        with suppress(OSError, ValueError):
            stamps.append((path.stat().st_mtime, path.stat().st_size))
    key = (repr(file), tuple(stamps), tuple(dofs))
    if key not in _known:
        while len(_known) >= MAX_EXAMINATIONS:
            _known.pop(next(iter(_known)))
        _known[key] = examine(file, dofs)
    return _known[key]


def refuse(file: RecordedFile, dofs: Sequence[str]) -> None:
    """Raise RecordingError if an excited axis agrees with nothing and the file is not trusted."""
    known = None if file.trust else examined(file, dofs)
    if known is None:
        return
    result, found = known.result, known.problems
    for axis in result.untrusted:
        if axis.dof in dofs:
            cures = [str(p) for p in found if axis.dof in p.axes] or [str(p) for p in found]
            cure = f"{cures[0]}; " if cures else ""
            name = ", ".join(map(str, file.files().values()))
            raise RecordingError(
                f"{name}: {axis.dof}: got a correlation of {axis.correlation:.2f} between the "
                f"velocity and the derivative of the pose, expected {LEAST_TRUSTED} or more; "
                f"{cure}{TRUST}"
            )


def diagnostics(file: RecordedFile, dofs: Sequence[str]) -> list[Diagnostic]:
    """Warn of every problem in one line, and return what was found as diagnostics."""
    read, known = file.account(dofs), examined(file, dofs)
    left_out = dict.fromkeys(line for signals in read for line in signals.left_out)
    columns = dict.fromkeys(reading[:4] for signals in read for reading in signals.readings)
    problems = known.problems if known else ()
    for line in (*left_out, *problems):
        log.warning("recording: %s", line)
    axes, lag = (known.result.axes, known.result.lag_s) if known else ((), None)
    texts = [(f"{option}: {name} ({origin})", unit) for option, name, unit, origin in columns]
    return [
        *(Diagnostic("recording_left_out", "all", None, i=i, label=line)
          for i, line in enumerate(left_out)),
        *(Diagnostic("recording_column", "all", None, unit, i=i, label=text)
          for i, (text, unit) in enumerate(texts)),
        *(Diagnostic(f"consistency_{name}", axis.dof, getattr(axis, name))
          for axis in axes for name in ("correlation", "scale")),
        *([Diagnostic("consistency_lag", "all", lag, "s")] if known else []),
        *(Diagnostic(f"recording_{p.kind}", "all", p.value, i=i, label=str(p))
          for i, p in enumerate(problems)),
    ]  # fmt: skip
