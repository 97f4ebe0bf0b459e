"""Comparison of stored runs: tables, figures and SQL, from the results database alone.

The modules that need SQLAlchemy or matplotlib are loaded when a command first uses them, as
`compare.frame`, so that --help starts fast (SPEC 1 of Scientific Python).
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from seatrial.runner.compare import animation as animation
    from seatrial.runner.compare import audit as audit
    from seatrial.runner.compare import benchmark_page as benchmark_page
    from seatrial.runner.compare import cli as cli
    from seatrial.runner.compare import frame as frame
    from seatrial.runner.compare import grid as grid
    from seatrial.runner.compare import leaderboard as leaderboard
    from seatrial.runner.compare import manoeuvre_comparison as manoeuvre_comparison
    from seatrial.runner.compare import page as page
    from seatrial.runner.compare import plots as plots
    from seatrial.runner.compare import report as report
    from seatrial.runner.compare import runs as runs
    from seatrial.runner.compare import site as site
    from seatrial.runner.compare import table as table
else:
    from pathlib import Path

    import lazy_loader

    _names = ["plots", *(path.stem for path in Path(__file__).parent.glob("[a-z]*.py"))]
    __getattr__, __dir__, __all__ = lazy_loader.attach(__name__, _names)
