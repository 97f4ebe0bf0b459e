"""Usage: seatrial fits [vessel=NAME,...] [GROUP=OPTION ...]

Which excitations, identifiers, controllers and evaluations vessels can have, each as the one choice
of a trial beside those that are given, and why not; of all vessels in about ten minutes. What is
left open is chosen by the vessel. Vessels that can have the same are shown together.
"""

import shutil
import sys
import textwrap
from collections import defaultdict
from collections.abc import Sequence

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.search_path import is_group, options
from seatrial.runner.sweeps import in_process
from seatrial.runner.sweeps.job import shown

CHOSEN = ("excitation", "identifier", "controller", "evaluation")
Fit = dict[str, str]  # why an option of a group does not fit, by its name; empty: it does


def main(words: Sequence[str]) -> int:
    """Run `seatrial fits` with the words that follow it; returns the exit code.

    Raises ConfigurationError for a word that is no choice of a group.
    """
    if {"-h", "--help"} & set(words):
        print(__doc__)
        return 0
    for word in words:
        group, _, name = word.partition("=")
        if not is_group(group) or not name or (group != "vessel" and "," in name):
            raise ConfigurationError(f"fits: got {word!r}, expected vessel=NAME or GROUP=OPTION")
    given = dict(word.split("=", 1) for word in words)
    vessels = given.pop("vessel", "").split(",") if "vessel" in given else options("vessel")
    alike = defaultdict[object, dict[str, dict[str, Fit]]](dict)  # by what fits, and by vessel
    for i, vessel in enumerate(vessels, 1):
        if len(vessels) > 1:
            print(f"{i} of {len(vessels)}: {vessel}", file=sys.stderr)
        groups = fits_of(vessel, given)
        fitting = {group: [name for name in fit if not fit[name]] for group, fit in groups.items()}
        alike[str(fitting)][vessel] = groups
    print("\n\n".join("\n".join(_lines(fits)) for fits in alike.values()))
    return 0


def fits_of(vessel: str, given: dict[str, str]) -> dict[str, Fit]:
    """Return by group which options fit a vessel, beside the choices that are given.

    Raises ConfigurationError if nothing does, for one reason.
    """
    fixed = [f"{group}={name}" for group, name in given.items()]
    words = {
        (group, name): [f"vessel={vessel}", *fixed, f"{group}={name}"]
        for group in CHOSEN
        if group not in given
        for name in options(group)
    }
    call = in_process.Call(["-m", "dry_run=true"], [*words.values()])
    call.lists = True
    in_process.run_sweep(call, ["dry_run=true"])
    refusals = {trial: note for state, trial, note in call.trials if state == "refused"}
    fits = defaultdict[str, Fit](dict)
    for (group, name), one in words.items():
        reason = refusals.get(shown(one), "")
        fits[group][name] = reason.removeprefix(f"{group}={name}").removeprefix(": ").strip()
    if len(reasons := {why for fit in fits.values() for why in fit.values()}) == 1 and any(reasons):
        raise ConfigurationError(reasons.pop())
    return fits


def _lines(fits: dict[str, dict[str, Fit]]) -> list[str]:
    """What vessels can have, and why not the rest, as lines of the terminal's width."""
    width, first = min(shutil.get_terminal_size().columns, 100), next(iter(fits))
    lines = textwrap.wrap(", ".join(fits), width)
    for group, fit in fits[first].items():
        lacking = defaultdict[str, list[str]](list)
        for name, why in fit.items():
            lacking[why.replace(first, "the vessel")].append(name)
        names = ", ".join(lacking.pop("", ["-"]))
        lines += textwrap.wrap(f"  {group:10s}  {names}", width, subsequent_indent=" " * 14)
        for why, which in lacking.items():
            text = f"not {', '.join(which)}: {why}"
            lines += textwrap.wrap(text, width, initial_indent=" " * 14, subsequent_indent=" " * 18)
    return lines
