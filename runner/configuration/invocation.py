"""Names of the two programs: modules in a checkout, or installed scripts.

Every command that is printed for the user begins with one of these names.
"""

import re
import shlex
import sys
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from pathlib import Path

from seatrial import __version__

ROOT = Path(__file__).resolve().parents[2]  # the checkout, or the installed package
PROJECT = ROOT / "pyproject.toml"  # in a checkout only
SCRIPTS = ("seatrial", "seatrial-results")
DEFAULT_DATABASE = "sqlite:///results/results.db"
# Commands and options that are gone, and what replaces them.
REPLACED: Mapping[str, str] = {
    "seatrial-results browse": "use pip install datasette; datasette results/results.db",
    "seatrial-results serve": "use seatrial-results site, whose pages open from disk",
    "seatrial-results scrub": "passwords are not stored, so there are none to remove",
    "seatrial-results --csv-plain": "CSV files always hold texts as they are",
    "seatrial-results csv-plain": "use csv, which holds texts as they are",
    "excitation=mix": "use excitation=optimal_design",
    "excitation.believed": "use excitation.nominal",
    "excitation.differentiation": "velocities are differentiated from the pose by central"
    " differences",
    "excitation.loop": "turning circles and zig-zags are sailed in open loop; signals such as prbs"
    " can be added to a controller",
    "excitation.sample_time_s": "excitation.resample_hz sets another than the median step",
    "excitation.thrusters": "a vessel with devices reads speeds and angles by"
    " excitation.columns.inputs",
    "excitation.zero_acceleration_bias": "subtract the bias of an accelerometer beforehand",
    "excitation.route.follow": "a planned mix is followed everywhere",
    "identifier.algorithm": "identifier=nsga2 searches by NSGA-II alone",
    "identifier.block_s": "standard errors are those for stationary residuals",
    "identifier.bootstrap": "standard errors are those for stationary residuals",
    "identifier.bound_factor": "use identifier.inertia_factor",
    "identifier.budget_s": "identifier=auto has no limit of time, on which its result would depend",
    "identifier.condition_limit": "the transformation to pose and velocity must be below 1000",
    "identifier.errors": "standard errors are those for stationary residuals",
    "identifier.feedthrough": "the data choose whether there is a direct term",
    "identifier.heading_span_deg": "use identifier.outputs",
    "identifier.half_life_s": "leave old samples out with excitation.start_s",
    "identifier.joint": "plsr is joint; surface_plsr treats each degree of freedom alone",
    "identifier.log_scale": "bounds are searched on a linear scale",
    "identifier.ned_force": 'use identifier=robust, or extra_terms=["cos(psi)","sin(psi)"]',
    "identifier.output": "use identifier.outputs",
    "identifier.resample": "standard errors are those for stationary residuals",
    "identifier.markov_parameters": "20 are stored",
    "identifier.recording": "the recording of identifier=command is always recording.csv",
    "identifier=least_squares": "use identifier=output_error",
    "identifier=gaussian_process": "use identifier=auto, which tries further terms",
    "identifier.sigma": "sigma is that of the residuals; identifier.outputs gives weights",
    "identifier.weighting": "use the checks of excitation=recording, which repair outliers",
    "identifier=sparse": "use identifier=robust for few, physical terms, or surface_plsr, which"
    " drops terms one by one",
    **{
        f"{group}={name}": f"in a checkout, use --config-dir docs/published {group}={name}"
        for group, names in (
            ("identifier", "grid linearised prediction_times"),
            (
                "experiment",
                "bargouth_section_4_2 bargouth_section_4_3 hoyer_figure_7_20"
                " hoyer_figure_7_21 hoyer_table_7_6",
            ),
        )
        for name in names.split()
    },
    "search.default_first": "the configuration as it is comes first, if the space contains it",
    "search.dof": "write search.metric=name:dof",
    "search.sampler": "the sampler is TPE; search.startup=<search.trials> makes a random search",
    "seatrial-results --execute": "use seatrial-results retry | sh",
    "seatrial-results --tag": "use --sweep, which takes a number, a name or a tag",
    "seatrial-results --interval": "intervals are those of Student's t",
    "seatrial-results stats": "use show RUN, which describes the recording too",
    "seatrial-results --execution full": "use --execution half, or order",
    "seatrial-results published": "in a checkout, use make published",
    "seatrial-results plot controllers": "use plot response --rows controller",
    "seatrial-results plot plan": "use plot track, which draws the plan of a mix too",
    "seatrial-results plot spectrum": "use plot excitation, which draws singular values and"
    " eigenvalues of a subspace identification too",
    "seatrial-results plot wind": "use plot excitation, which draws the wind of the recording, or"
    " plot response for its force on a mission",
    "seatrial-results plot quality": "use seatrial data check FILE --html PAGE.html",
    "search.model": "the objective is a metric of the identified model",
    "search.stage": "the objective is of the deployment, or of the first stage that has the metric",
    "search.statistic": "the objective is the median over the seeds",
    "seatrial-results plot search": "use seatrial-results table --rows <option> --metric <metric>;"
    " a search prints its best candidates",
    "seatrial-results plot times": "in a checkout, use make published, whose page has the figure",
    "seatrial-results plot topology": "in a checkout, use make published, whose page has the"
    " figure",
}


def in_checkout(root: Path = ROOT) -> bool:
    """Return whether the sources are in a checkout, and not installed."""
    return (root / "pyproject.toml").is_file()


def program_version() -> str:
    """Return the version of this seatrial, and whether it is a checkout."""
    return f"{__version__} (checkout)" if in_checkout() else __version__


def by_script(typed: Sequence[str]) -> bool:
    """Return whether a command line (as in `sys.orig_argv`) starts an installed script."""
    return len(typed) > 1 and Path(typed[1]).stem in SCRIPTS


def trial_program() -> str:
    """Return the command that runs trials: `python -m runner` or `seatrial`."""
    return "python -m runner" if _modules() else "seatrial"


def results_program() -> str:
    """Return the command for results: `python -m runner.compare` or `seatrial-results`."""
    return "python -m runner.compare" if _modules() else "seatrial-results"


def typed_command(typed: Sequence[str]) -> str:
    """Quote a command line, as in `sys.orig_argv`, for a shell."""
    return shlex.join([Path(typed[1]).stem, *typed[2:]] if by_script(typed) else typed)


def config_folder(typed: str) -> list[str]:
    """Return the words of a typed command line that name its folder of options."""
    parser = ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config-dir", "-cd")
    folder = parser.parse_known_args(shlex.split(typed))[0].config_dir
    return ["--config-dir", folder] if folder else []


def quoted(text: str) -> str:
    """Return a text as the grammar of overrides reads it, in quotes where it needs them."""
    plain = re.fullmatch(r"[A-Za-z_/.][\w/.:+-]*", text, re.ASCII)
    if plain and text.lower() not in ("null", "true", "false", "nan", "inf"):
        return text
    escaped = re.sub(r"(\\*)'", r"\1\1\\'", text)  # backslashes count before a quote only
    trailing = escaped[len(escaped.rstrip("\\")) :]
    return f"'{escaped}{trailing}'"


def import_from_working_folder() -> None:
    """Let the parts of the user's own be found, after everything that is installed."""
    folder = str(Path.cwd())
    if not {"", folder} & set(sys.path):
        sys.path.append(folder)


def _modules() -> bool:
    return in_checkout() and not by_script(sys.orig_argv)
