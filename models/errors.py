"""The errors a user can cause or meet; everything else is a bug and is not caught.

    SeatrialError
    |- ConfigurationError     an option is unknown, of the wrong type, or out of range
    |- RecordingError         a measured file cannot be read as a recording
    |- IdentificationError    the data do not determine the model that was asked for
    |- Diverged               a simulation left the limits of the vessel
    `- LogbookError           the results database cannot be used

A message is one line: what, where, what was got, what was expected.
"""


class SeatrialError(Exception):
    """Base of all errors that are shown as one line."""


class ConfigurationError(SeatrialError):
    """An option is unknown, of the wrong type, or out of range."""


class RecordingError(SeatrialError):
    """A measured file cannot be read as a recording."""


class IdentificationError(SeatrialError):
    """The data do not determine the model that was asked for."""


class Diverged(SeatrialError):  # noqa: N818 - it is an outcome, and named as the run's status
    """A simulation left the limits of the vessel.

    `time_s` is the time since the start [s], `quantity` the name of the state that left.
    """

    def __init__(self, message: str, time_s: float, quantity: str) -> None:
        super().__init__(message)
        self.time_s = time_s
        self.quantity = quantity

    def __reduce__(self) -> tuple[type["Diverged"], tuple[str, float, str]]:
        return type(self), (str(self), self.time_s, self.quantity)


class LogbookError(SeatrialError):
    """The results database cannot be used."""
