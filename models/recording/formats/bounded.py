"""Foreign readers within bounds of memory; what they raise becomes one line."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from textwrap import shorten

from seatrial.models.errors import RecordingError, SeatrialError

LARGEST_GROWTH = 2**30  # bytes of addresses that reading a file may take beside those in use
PAGES = Path("/proc/self/statm")


@contextmanager
def bounded(path: Path, expected: str) -> Iterator[None]:
    """Bound the memory of a reader that is not ours, and name the file where it fails.

    A damaged file can make a reader raise anything, and a small compressed file can ask for all
    memory there is. Raises RecordingError.
    """
    try:
        with _limited():
            yield
    except SeatrialError:
        raise
    except MemoryError as error:
        raise RecordingError(
            f"{path}: takes more than {LARGEST_GROWTH / 1e9:.1g} GB to read, expected {expected} "
            "of a recording; cut it"
        ) from error
    except Exception as error:  # a foreign parser on a damaged file may raise anything
        reason = shorten(f"{type(error).__name__} {error}".strip(), 200, placeholder=" ...")
        raise RecordingError(f"{path}: cannot be read ({reason}), expected {expected}") from error


@contextmanager
def _limited() -> Iterator[None]:
    """Limit the addresses of this process while a file is read."""
    if not PAGES.exists():
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(PAGES.read_text().split()[0]) * resource.getpagesize()
    allowed = [bound for bound in (soft, hard) if bound != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min([used + LARGEST_GROWTH, *allowed]), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
