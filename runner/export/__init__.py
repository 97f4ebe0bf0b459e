"""Models of stored runs in the formats of other programs, and as vessels of further trials.

`stored_model` reads a model, `model_formats` writes it. The modules are imported at first use,
because the command line must start fast.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from seatrial.runner.export import manoeuvre_tracks as manoeuvre_tracks
    from seatrial.runner.export import model_formats as model_formats
    from seatrial.runner.export import stored_model as stored_model
else:
    import lazy_loader

    __getattr__, __dir__, __all__ = lazy_loader.attach(
        __name__, ["manoeuvre_tracks", "model_formats", "stored_model"]
    )
