"""The report of a recording as tables in the terminal and as a page with figures."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, NamedTuple

from seatrial.models.recording.consistency import Consistency
from seatrial.runner.compare.page import Picture, picture, render_page
from seatrial.runner.recording_report import Report

if TYPE_CHECKING:  # slow to import
    from seatrial.runner import recording_figures
else:
    import lazy_loader

    recording_figures = lazy_loader.load("seatrial.runner.recording_figures", suppress_warning=True)


class PageTable(NamedTuple):
    """A table: title, heads of the columns, and rows of text."""

    title: str
    heads: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def sheets(report: Report) -> Iterator[PageTable]:
    """The tables of a report, in the order of the page."""
    rows = [
        (name or "-", f"{s.count}", f"{s.duration_s:.1f}", f"{s.rate_hz:.4g}", f"{s.gaps}",
         f"{s.longest_gap_s:.3g} at {s.longest_gap_at_s:.0f}" if s.gaps else "-",
         f"{100.0 * s.missing:.1f}", f"{s.not_later}")
        for name, s in report.samplings.items()
    ]  # fmt: skip
    heads: tuple[str, ...] = (
        "source", "rows", "duration [s]", "rate [Hz]", "gaps", "longest [s]", "missing [%]",
        "repeated times",
    )  # fmt: skip
    yield PageTable("Sampling", heads, rows)
    if report.readings:
        read = [(r.option, r.column, r.unit or "-", r.known_from) for r in report.readings]
        yield PageTable("Columns", ("quantity", "column", "unit", "known from"), read)
    if report.examination is None:
        return
    result = report.examination.result
    yield _agreement(result)
    if report.offsets:
        offsets = [
            (o.source, f"{o.seconds:+.3f}", f"{o.correlation:.3f}", o.column, o.signal)
            for o in report.offsets
        ]
        heads = ("source", "behind [s]", "correlation", "column", "compared with")
        yield PageTable("Clocks of the sources", heads, offsets)
    numbers = [(r.name, r.unit, f"{r.least:.3g}", f"{r.most:.3g}", f"{r.deviation:.3g}",
                f"{r.noise:.2g}", f"{r.outliers}") for r in report.ranges]  # fmt: skip
    heads = ("velocity", "unit", "least", "most", "deviation", "noise", "outliers")
    yield PageTable("Ranges", heads, numbers)
    if report.terms:
        terms = [(dof, " and ".join(names)) for dof, names in report.terms.items()]
        yield PageTable("Terms that are not told apart", ("axis", "terms"), terms)


def _agreement(result: Consistency) -> PageTable:
    kinds = (("velocity", result.velocities), ("acceleration", result.accelerations))
    rows = [
        (axis.dof, kind, f"{axis.correlation:.3f}", f"{axis.scale:.3f}",
         "yes" if axis.excited else "no")
        for kind, axes in kinds
        for axis in axes
    ]  # fmt: skip
    title = (
        f"Pose and velocity, below {result.cutoff_hz:.2g} Hz; the velocities are "
        f"{result.lag_s:+.3f} s behind"
    )
    return PageTable(title, ("axis", "compared", "correlation", "scale", "excited"), rows)


def page(report: Report) -> str:
    """The report as one HTML file."""
    problems = () if report.examination is None else report.examination.problems
    return render_page(
        "recording.html", title=f"Recording {report.path}", report=report, problems=problems,
        sheets=tuple(sheets(report)), pictures=_pictures(report),
    )  # fmt: skip


def _pictures(report: Report) -> tuple[Picture, ...]:
    if report.examination is None:
        return ()
    known = report.examination
    drawn = (
        (recording_figures.velocities(known), "Velocities, recorded and from the pose"),
        (recording_figures.spectra(known), "Spectra of the velocities"),
        (recording_figures.track(known), "Track"),
    )
    return tuple(picture(sheet, text, f"f{i}-") for i, (sheet, text) in enumerate(drawn))
