"""Mean ranks of the benchmark's entrants, and which do not differ, as in Demsar (2006), Fig. 1."""

import pandas as pd
from matplotlib.figure import Figure as Chart

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.leaderboard import alike, boards, critical_difference, groups, overall
from seatrial.runner.compare.plots import style

FIGURE = Figure(
    "critical_difference",
    "Mean ranks of the benchmark's entrants, in each task and over tasks with the same ones; bars"
    " join those that do not differ significantly.",
    "runs of the command benchmark",
    (),
)

ROW = 0.24  # height of a line of the figure [inch]
SIDE = 0.42  # width of the names on either side, of the range of ranks
NOTE = (
    "1 is the best rank; a bar joins neighbours of which no two differ significantly (signed-rank"
    " tests of all pairs with Holm's correction); CD: the difference of two ranks that the more"
    " cautious test of Nemenyi calls significant"
)


def drawings(results: Queries, request: PlotRequest) -> list[style.Drawing]:
    """Draw one figure of each group of tasks with the same entrants, and one of each task."""
    own = [board for board in boards(results) if len(board.ranked)]
    if not own:
        raise ConfigurationError("plot critical_difference: no task of the benchmark has been run")
    drawn = list[style.Drawing]()
    for group, ranks in (*overall(own)[::-1], *(([board], board.ranked) for board in own)):
        if len(ranks):
            name = f"critical_difference-{'-'.join(board.task.name for board in group)}"
            figure = chart(", ".join(board.task.title for board in group), ranks)
            drawn.append(style.Drawing(name, figure))
    return drawn


def chart(title: str, ranks: pd.DataFrame) -> Chart:
    """Return the figure of the ranks of one set of cases, the better half at the left."""
    means, cases = ranks.mean(), len(ranks)
    count, joined = len(means), groups(alike(ranks))
    half = -(-count // 2)
    figure, (axes,) = style.panels(1, 1, 7.0, ROW * (half + len(joined)) + 2.2)
    axes.plot([1.0, count], [0.0, 0.0], color=style.REFERENCE, linewidth=1.0)
    for rank in range(1, count + 1):
        axes.plot([rank, rank], [0.0, 0.3], color=style.REFERENCE, linewidth=1.0)
        axes.text(rank, 0.45, str(rank), ha="center", va="bottom", fontsize=9)
    difference = critical_difference(count, cases)
    ends = [1.0, min(1.0 + difference, float(count))]
    text = f"CD = {number_text(difference, 3)}"
    text += ", more than all ranks" if 1.0 + difference > count else ""
    axes.plot(ends, [2.0, 2.0], color=style.MUTED, linewidth=1.4, marker="|", markersize=8)
    axes.text(1.0, 2.3, text, ha="left", va="bottom", fontsize=9, color=style.MUTED)
    height = -0.6
    for group in joined:
        ends = [float(means[group[0]]) - 0.04, float(means[group[-1]]) + 0.04]
        axes.plot(ends, [height, height], color=style.PALETTE[5], lw=4.0, solid_capstyle="butt")
        height -= 0.6
    below, room = height - 0.4, SIDE * (count - 1.0)
    inner = 0.1 * (count - 1.0 + 2.0 * room) * SIDE
    for place, (name, rank) in enumerate(means.items()):
        left = place < half
        height = below - (place if left else count - 1 - place)
        edge, shown = 1.0 - inner if left else count + inner, str(name).replace("_", " ")
        axes.plot([rank, rank, edge], [0.0, height, height], color=style.REFERENCE, linewidth=0.8)
        text = f"{shown}  {rank:.2f}" if left else f"{rank:.2f}  {shown}"
        side = -0.3 * inner if left else 0.3 * inner
        axes.text(edge + side, height, text, ha="right" if left else "left", va="center")
    axes.set(xlim=(1.0 - room, count + room), ylim=(below - half + 0.4, 3.6))
    axes.set_axis_off()
    title = f"{title}: mean ranks over {cases} case{'s'[: cases != 1]}"
    return style.drawing_of("critical_difference", figure, [axes], title, [NOTE]).figure
