"""Addresses of databases that hold a password are refused as options.

What is given as an option is stored with the results, printed and shown in lists of processes.
"""

import re
from collections.abc import Iterable

from seatrial.models.errors import ConfigurationError

_PASSWORD = re.compile(
    r"postgres[\w+]*://(?:[^:/?@]*:[^@]+@|[^?]*\?(?:.*&)?(?:ssl)?password=)", re.IGNORECASE
)


def refuse_passwords(texts: Iterable[str]) -> None:
    r"""Raise ConfigurationError if a text, such as an override, holds a password.

    An address may have Hydra's escapes: `database.url=postgresql\://me\:secret@host/name`.
    """
    if any(_PASSWORD.search(text.replace("\\", "")) for text in texts):
        raise ConfigurationError(
            "the address of the database holds a password, which must not be an option: use"
            " SEATRIAL_DATABASE, PGPASSWORD or ~/.pgpass"
        )
