"""Sea trials for models and controllers of marine vessels.

    import seatrial as st

    run = st.run(identifier="ls", disturbance="noise", seed=1)
    sweep = st.sweep(["identifier=ls,plsr", "disturbance=calm,noise"], seed=range(5))
    sweep.table(metric="e_pos_mae")

The names are imported at first use (SPEC 1 of Scientific Python). In a checkout `models`, `runner`
and `conf` in this folder are links to the folders beside it.
"""

from typing import TYPE_CHECKING

__version__ = "0.2.0"

if TYPE_CHECKING:
    from seatrial.models.errors import ConfigurationError as ConfigurationError
    from seatrial.models.errors import Diverged as Diverged
    from seatrial.models.errors import IdentificationError as IdentificationError
    from seatrial.models.errors import LogbookError as LogbookError
    from seatrial.models.errors import RecordingError as RecordingError
    from seatrial.models.errors import SeatrialError as SeatrialError
    from seatrial.runner.interface.models import Model as Model
    from seatrial.runner.interface.models import Recording as Recording
    from seatrial.runner.interface.models import Vessel as Vessel
    from seatrial.runner.interface.runs import Logbook as Logbook
    from seatrial.runner.interface.runs import Run as Run
    from seatrial.runner.interface.runs import RunFailed as RunFailed
    from seatrial.runner.interface.runs import Table as Table
    from seatrial.runner.interface.runs import open as open
    from seatrial.runner.interface.runs import run as run
    from seatrial.runner.interface.runs import sweep as sweep
    from seatrial.runner.interface.scikit_learn import Estimator as Estimator
else:
    import lazy_loader

    __getattr__, __dir__, __all__ = lazy_loader.attach(
        __name__,
        submod_attrs={
            "models.errors": [
                *("ConfigurationError", "Diverged", "IdentificationError", "LogbookError"),
                *("RecordingError", "SeatrialError"),
            ],
            "runner.interface.models": ["Model", "Recording", "Vessel"],
            "runner.interface.runs": [
                *("Logbook", "Run", "RunFailed", "Table", "open", "run", "sweep")
            ],
            "runner.interface.scikit_learn": ["Estimator"],
        },
    )
