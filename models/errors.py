"""Errors that the user can cause or encounter; any other exception is a bug and is not caught.

    SeatrialError
    |- ConfigurationError     an option is unknown, of the wrong type, or out of range
    |- RecordingError         a measured file cannot be read as a recording
    |- IdentificationError    the data do not determine the requested model
    |- Diverged               a simulation exceeded the limits of the vessel
    |- PartError              a part from elsewhere fails, or returns what cannot be used
    `- LogbookError           the results database cannot be used

A message is one line: what, where, what was received, what was expected.
"""


class SeatrialError(Exception):
    """Base of all errors that are shown as one line."""


class ConfigurationError(SeatrialError):
    """An option is unknown, of the wrong type, or out of range."""


class RecordingError(SeatrialError):
    """A measured file cannot be read as a recording."""


class IdentificationError(SeatrialError):
    """The data do not determine the requested model."""


class Diverged(SeatrialError):  # noqa: N818 - named like the status of the run
    """A simulation exceeded the limits of the vessel.

    `time_s` is the time since the start [s], `quantity` the name of the state that exceeded its
    limit.
    """

    def __init__(self, message: str, time_s: float, quantity: str) -> None:
        super().__init__(message)
        self.time_s = time_s
        self.quantity = quantity

    def __reduce__(self) -> tuple[type["Diverged"], tuple[str, float, str]]:
        return type(self), (str(self), self.time_s, self.quantity)


class PartError(SeatrialError):
    """A part from elsewhere fails, or returns what cannot be used."""


class LogbookError(SeatrialError):
    """The results database cannot be used."""
