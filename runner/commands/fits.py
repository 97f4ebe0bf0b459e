"""Usage: seatrial fits [vessel=NAME,...] [GROUP=OPTION ...]

Which excitations, identifiers, controllers and evaluations vessels can have, each as the one choice
of a trial beside those that are given, and why not. What is left open is chosen by the vessel.
Vessels that can have the same are shown together.
"""

import shutil
import sys
import textwrap
from collections import defaultdict
from collections.abc import Sequence

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration import hydra_errors
from seatrial.runner.configuration.search_path import is_group, options
from seatrial.runner.sweeps import composition, in_process, job

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
            flag, one = group.lstrip("-"), name.partition(",")[0] or group
            kinds = [flag] if is_group(flag) else ["vessel", *CHOSEN]
            hints = [f"did you mean {kind}={one}? " for kind in kinds if one in options(kind)][:1]
            expected = "".join([*hints, "expected vessel=NAME or GROUP=OPTION"])
            raise ConfigurationError(f"fits: got {word!r}, {expected}")
    given = dict(word.split("=", 1) for word in words)
    vessels = given.pop("vessel").split(",") if "vessel" in given else options("vessel")
    alike = defaultdict[object, dict[str, dict[str, Fit]]](dict)  # by what fits, and by vessel
    for vessel, groups in fits_of(vessels, given).items():
        fitting = {group: [name for name in fit if not fit[name]] for group, fit in groups.items()}
        alike[str(fitting)][vessel] = groups
    print("\n\n".join("\n".join(_lines(fits)) for fits in alike.values()))
    return 0


def fits_of(vessels: Sequence[str], given: dict[str, str]) -> dict[str, dict[str, Fit]]:
    """Return by vessel and group which options fit, beside the choices that are given.

    Raises ConfigurationError if nothing fits a vessel, for one reason.
    """
    groups = {group: options(group) for group in CHOSEN if group not in given}
    choices = [(group, name) for group, names in groups.items() for name in names]
    if not groups:
        raise ConfigurationError("fits: got a choice of each group; dry_run=true checks a trial")
    fits = {vessel: {group: Fit() for group in groups} for vessel in vessels}
    call = in_process.Call(())
    call.started = True
    with in_process.hydra_of((), call) as hydra:
        trials = composition.Alternatives(hydra.config_loader, vessels[0], given, groups)
        for i, vessel in enumerate(vessels, 1):
            if vessels[1:]:
                print(f"{i} of {len(vessels)}: {vessel}", file=sys.stderr)
            for group, name in choices:
                fits[vessel][group][name] = ""
                try:
                    job.prepare(trials.order(vessel, group, name))
                except hydra_errors.EXPECTED as error:
                    reason = hydra_errors.one_line(error).removeprefix(f"{group}={name}")
                    fits[vessel][group][name] = reason.removeprefix(": ").strip()
    for of_vessel in fits.values():
        reasons = {why for fit in of_vessel.values() for why in fit.values()}
        if len(reasons) == 1 and any(reasons):
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
