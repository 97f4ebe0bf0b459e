"""Like with like: which numbers a cell may pool, and what counts as a replicate.

The *conditions* of a number are everything in its run that can change it, except the seed: the
options, the configuration and the code. What happens after a stage of the trial cannot change its
numbers, and neither the nominal model nor the plant depends on the identifier. Two numbers of equal
conditions and equal seed are one experiment, stored twice. The seed counts only if one of the
random streams that the number depends on was drawn.
"""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.frame import FINISHED, METRIC_FACTORS, POOLED, Queries, codes
from seatrial.runner.record.vocabulary import GROUPS, NOT_COMPARED

STORAGE = (*NOT_COMPARED, "metrics", "seed")
AFTER_VALIDATION = ("evaluation", "plant.change", "update")
WITHOUT_IDENTIFIER = ("mean_motion", "nominal", "plant")
MOST_SPLITS = 3
EVERY_SEED = ""  # the `replicate` of a number that depends on no random stream
EXPERIMENT = ("condition", "replicate", *METRIC_FACTORS)  # equal: one experiment, stored twice


def within(key: str, names: Iterable[str]) -> bool:
    """Return whether a dotted key is one of the names, or lies below one of them."""
    return any(key == name or key.startswith(f"{name}.") for name in names)


def with_conditions(
    results: Queries, trials: pd.DataFrame, frame: pd.DataFrame
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Number the conditions of the observations of some trials, and say which seed each depends on.

    Returns the frame with the columns `condition` and `replicate`, which is the seed or EVERY_SEED;
    and the facts of every condition: a row for each `condition`, a column for each name, of text,
    missing where a name cannot change the number.
    """
    known = trials["of_experiment"].astype(object)  # equal: the runs differ in the seed alone
    experiments = known.where(known.notna(), "run " + trials.index.astype(str))
    plain = frame["model"].isin(WITHOUT_IDENTIFIER)
    own = pd.DataFrame({"experiment": frame["run"].map(experiments), "plain": plain})
    own["late"] = frame["stage"] != "deployment"
    kind = codes(own, [*own])
    each = own[~kind.duplicated()]
    first = experiments[~experiments.duplicated() & experiments.isin(each["experiment"])]
    configs, code = results.configs_of(first.index.tolist()), trials["of_code"].astype(object)
    told = trials[list(GROUPS)].assign(code=code.fillna("unknown")).loc[first.index]
    facts_of = {
        first[run]: choices | {key: str(value) for key, value in configs[run].items()}
        for run, choices in told.to_dict("index").items()
    }
    facts = pd.DataFrame.from_records([facts_of[name] for name in each["experiment"]])
    facts = facts.drop(columns=[name for name in facts if within(name, STORAGE)])
    for name in facts:
        if within(name, AFTER_VALIDATION):
            facts.loc[each["late"].to_numpy(), name] = np.nan
        if within(name, ["identifier"]):
            facts.loc[each["plain"].to_numpy(), name] = np.nan
    number = codes(facts, [name for name in facts if facts[name].nunique(dropna=False) > 1])
    fixed = (frame["streams"] == "") | (plain & frame["streams"].isin(["", "identifier"]))
    replicate = frame["seed"].astype(object).where(~fixed, EVERY_SEED).astype("category")
    condition, facts = number.to_numpy()[kind.to_numpy()], facts[~number.duplicated()]
    return frame.assign(condition=condition, replicate=replicate), facts.reset_index(drop=True)


def of_runs(trials: pd.DataFrame, stage: str, model: str = "identified") -> pd.DataFrame:
    """Return a frame with one row for each finished run: a number of this stage and model."""
    frame = trials[trials["status"] == FINISHED].reset_index(names="run")
    own = {"stage": stage, "model": model, "metric": "", "dof": "all", "file": POOLED}
    return frame.assign(**own)


def distinct(frame: pd.DataFrame, within_columns: Sequence[str] = ()) -> pd.DataFrame:
    """Return one number of every experiment, the newest, in the order of the first."""
    keys = codes(frame, [*within_columns, *EXPERIMENT])
    kept = ~keys.duplicated(keep="last")
    return frame[kept].iloc[np.argsort(keys[kept], kind="stable")]


def differing(
    facts: pd.DataFrame, cells: pd.Series, conditions: pd.Series, pooled: Sequence[str] = ()
) -> list[str]:
    """Return the factors that make every cell alike if they become factors of the table.

    `cells` and `conditions` are those of each number, shape (n,), `facts` those of the conditions;
    cells may average over what is `pooled`, and over all that lies below it. Options of a group
    stand before keys of the configuration, so that keys that follow from an option are not named.
    """
    members = pd.DataFrame({"cell": cells, "condition": conditions}).drop_duplicates()
    levels = facts.loc[members["condition"]].reset_index(drop=True)
    hidden = [name for name in levels if within(name, pooled)]
    part = codes(levels.assign(**{"": members["cell"].to_numpy()}), ["", *hidden])
    factors = []
    for name in [*GROUPS, *(name for name in levels if name not in GROUPS)]:
        if not part.duplicated().any():
            break
        split = codes(pd.DataFrame({"part": part, "level": levels[name]}), ["part", "level"])
        if split.nunique() > part.nunique():
            factors.append(name)
            part = split
    return factors


class TooDifferentError(ConfigurationError):
    """Runs differ in too many factors for one table or figure."""


def require_few(factors: Sequence[str], what: str) -> None:
    """Raise TooDifferentError if the runs differ in more factors than a table can show."""
    if len(factors) > MOST_SPLITS:
        more = ", ..." if len(factors) > 8 else ""
        raise TooDifferentError(
            f"{what} would average over {', '.join(factors[:8])}{more}: name them in --rows or"
            f" --columns, select by --where or --sweep, or say --pool {','.join(factors[:8])}"
        )


def by_seed(frame: pd.DataFrame) -> pd.DataFrame:
    """Average the numbers of each cell over their levels within a seed: levels are no replicates.

    Where every level has a seed of its own, the seeds are averaged over the levels that they have.
    A number that depends on no seed belongs to every seed that its cell has. `frame` has distinct
    observations with a value, and their `cell`. Returns a row for each cell and replicate: cell,
    replicate, value, and whether it is `whole`: that of a seed that lacks a level is left out.
    """
    own = frame[["cell", "replicate", "value"]].assign(
        level=codes(frame, ["condition", *METRIC_FACTORS]), replicate=frame["replicate"].astype(str)
    )
    count = own.groupby("cell")["level"].nunique()
    alone = own.groupby(["cell", "level"]).size().groupby("cell").max() == 1
    own = _on_every_seed(own, ["level"])
    means = own.groupby(["cell", "replicate"])["value"].agg(["mean", "size"])
    means = means.reset_index().rename(columns={"mean": "value"})
    whole = means["cell"].map(alone) | (means["size"] == means["cell"].map(count))
    return means.drop(columns="size").assign(whole=whole)


def _on_every_seed(rows: pd.DataFrame, level: list[str]) -> pd.DataFrame:
    """Repeat what depends on no seed for each seed of its cell that lacks the level."""
    every = rows["replicate"] == EVERY_SEED
    seeds = rows.loc[~every, ["cell", "replicate"]].drop_duplicates()
    spread = rows[every].drop(columns="replicate").merge(seeds, how="left", on="cell")
    spread = spread.fillna({"replicate": EVERY_SEED})
    return pd.concat([rows[~every], spread]).drop_duplicates(["cell", *level, "replicate"])


def pairs(
    frame: pd.DataFrame, facts: pd.DataFrame, baseline: Mapping[str, str], named: Sequence[str]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Set the numbers of each cell beside their counterparts of a baseline.

    A counterpart is equal in everything but the factors of the baseline, and in the seed if both
    depend on one. Where the baseline has several configurations, a counterpart is also equal in
    what they differ in. Each pair of experiments counts once, averaged within its seed; one
    that depends on no seed belongs to every seed. A seed that lacks a level of others is left out.

    `frame` has distinct observations with a value, those of the baseline without a `cell` (-1), and
    `facts` describe their conditions; `baseline` has the level of each of its factors, and `named`
    are the other factors of the table. Returns the pairs: cell, replicate, own value, and `other`,
    that of the baseline; and the seeds that it has under the conditions of each cell.
    """
    fixed = tuple(name for name in baseline if name not in METRIC_FACTORS)
    ignored = fixed if "model" not in baseline else (*fixed, "identifier")
    free = [name for name in METRIC_FACTORS if name not in baseline]
    rows = frame[["cell", "condition", "replicate", "value", *free]].astype({"replicate": str})
    shared = [name for name in facts if not within(name, ignored)]
    below = [name for name in facts if within(name, fixed) and name not in baseline]
    levels = facts.loc[rows.loc[rows["cell"] < 0, "condition"].unique()]
    several = levels[below].groupby(codes(levels, shared)).nunique(dropna=False).gt(1).any()
    decisive = [name for name in below if name in named or several[name]]
    rows["shared"] = codes(facts, [*shared, *decisive]).to_numpy()[rows["condition"]]
    rows["key"] = codes(rows, [*free, "shared"])
    own = rows.loc[rows["cell"] >= 0, ["cell", "key", "condition", "replicate", "value"]]
    other = rows.loc[rows["cell"] < 0, ["key", "replicate", "value"]]
    other = other.rename(columns={"value": "other"})
    known = own[["cell", "key"]].drop_duplicates().merge(other[["key", "replicate"]], on="key")
    fix, free_ = own["replicate"] == EVERY_SEED, other["replicate"] == EVERY_SEED
    each = [
        own.merge(other, on=["key", "replicate"]),
        own[~fix].merge(other[free_].drop(columns="replicate"), on="key"),
        own[fix].drop(columns="replicate").merge(other[~free_], on="key"),
    ]
    every = _on_every_seed(pd.concat(each), ["key", "condition"])
    seeds = every.groupby(["cell", "key", "condition"]).size().groupby("cell").max()
    grouped = every.groupby(["cell", "replicate"], sort=False)
    both, size = grouped[["value", "other"]].mean(), grouped.size()
    whole = size == size.groupby("cell").transform("max")
    both = both[whole | (size.index.get_level_values("cell").map(seeds) == 1)]
    return both.reset_index(), known[["cell", "replicate"]].drop_duplicates()
