"""Work in a thread while a block runs."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread


@contextmanager
def in_background(work: Callable[[Event], None]) -> Iterator[None]:
    """Run `work` while the block runs; it gets the event that the block has ended."""
    ended = Event()
    thread = Thread(target=work, args=(ended,), daemon=True)
    try:
        thread.start()
        yield
    finally:
        ended.set()
        if thread.is_alive():  # a signal can come before it has started
            thread.join()
