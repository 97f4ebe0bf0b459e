"""What the options of a part ask of the machine, stated before any work.

The unit of work is the sample: one that is simulated (with one integration step), predicted for a
candidate or drawn by a bootstrap. Each takes about a microsecond. Other work is counted in the
samples that take as long, at `FLOPS` floating-point operations each.
"""

from dataclasses import dataclass, replace

FLOPS = 1e3  # operations in the time of a sample
NUMBER = 8.0  # bytes of a number
FINDING = 60.0 * NUMBER  # bytes of a finding


@dataclass(frozen=True)
class Extent:
    """The samples that a part has to process."""

    samples: float
    period_s: float
    n_dof: int
    n_terms: int  # of the nominal model


@dataclass(frozen=True)
class Demand:
    """The work [samples] and the memory [bytes] that follow from one option.

    `option` is named from the part that declares it, `detail` says in words what it takes.
    """

    option: str
    got: object
    detail: str
    samples: float
    memory: float = 0.0

    def of(self, group: str, times: float = 1.0) -> "Demand":
        """The demand of a part inside another one, which repeats its work."""
        return replace(self, option=f"{group}.{self.option}", samples=times * self.samples)


def amount(number: float) -> str:
    """A count in at most two significant digits, as in `1e13`."""
    if number < 1e4:
        return f"{number:.0f}"
    digits, _, exponent = f"{number:.1e}".partition("e")
    return f"{digits.removesuffix('.0')}e{int(exponent)}"


def bootstrap_demand(replicates: int | None, extent: Extent) -> list[Demand]:
    """Replicates that draw every sample, and keep one table each."""
    if replicates is None:
        return []
    table = NUMBER * extent.n_terms * extent.n_dof
    detail = f"{amount(replicates)} replicates of {amount(extent.samples)} samples"
    work = replicates * extent.samples
    return [Demand("bootstrap", replicates, detail, work, replicates * table)]
