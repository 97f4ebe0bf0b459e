"""Data as scripts: a page opened from disk may not fetch files, but it may load scripts.

A script hands one JSON value to the page: `seatrial.receive("data/progress.js", ...);`.
"""

import json
import re
from hashlib import sha256

SUMMARY, PROGRESS, FAILURES = "data/summary.js", "data/progress.js", "data/failures.js"
RUN = re.compile(r"data/run-(\d{1,18})\.js")


def metric_script(name: str) -> str:
    """Return the name of the script of a metric; metrics have any name, files do not."""
    return _script("metric", name)


def coefficient_script(term: str) -> str:
    """Return the name of the script of the coefficients of a term."""
    return _script("coefficient", term)


def _script(kind: str, name: str) -> str:
    return f"data/{kind}-{sha256(name.encode('utf-8', 'backslashreplace')).hexdigest()[:16]}.js"


def tables_script(sweep: int | None) -> str:
    """Return the name of the script of the tables of a sweep, None for all runs."""
    return f"data/tables-{sweep or 'all'}.js"


def run_script(run_id: int) -> str:
    """Return the name of the script of a run."""
    return f"data/run-{run_id}.js"


def script_of(name: str, content: object) -> str:
    """Return a script in ASCII that hands `content` to the page.

    No text of the database can end the script or a string in it: `<` and all that is not ASCII are
    escaped. Numbers keep their full precision; `content` may hold no NaN.
    """
    text = json.dumps(content, ensure_ascii=True, allow_nan=False, separators=(",", ":"))
    text = text.replace("<", "\\u003c")
    return f"seatrial.receive({json.dumps(name)}, {text});\n"
