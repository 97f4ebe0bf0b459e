"""What was tried, what held and what did not, as a table and as JSON."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Entry:
    """One kind of abuse: the number of tries, the violations, and the reason if it was skipped."""

    what: str
    tried: int = 0
    violations: list[str] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    skipped: str = ""
    seconds: float = 0.0

    @property
    def held(self) -> int:
        """Tries without a violation."""
        return self.tried - len(self.violations)

    @contextmanager
    def attempt(self, name: str, repeat: str) -> Iterator[None]:
        """Count one try; a failed assertion in the block is its violation.

        `repeat` is the command that repeats it.
        """
        self.tried += 1
        try:
            yield
        except AssertionError as error:
            self.violate(name, str(error) or "an assertion failed", repeat)

    def violate(self, name: str, reason: str, repeat: str) -> None:
        """Note a violation and print it at once with the command that repeats it."""
        self.violations.append(f"{name}: {reason}")
        print(f"VIOLATED {self.what}: {name}: {reason}\n  repeat: {repeat}", flush=True)

    def remark(self, text: str) -> None:
        """Note something that holds but deserves attention."""
        self.remarks.append(text)


def table(entries: Sequence[Entry]) -> str:
    """The entries as a Markdown table, with a row of totals."""
    lines = ["| what | tried | held | violated |", "|---|---:|---:|---:|"]
    for entry in entries:
        what = f"{entry.what} (skipped: {entry.skipped})" if entry.skipped else entry.what
        lines.append(f"| {what} | {entry.tried} | {entry.held} | {len(entry.violations)} |")
    tried = sum(entry.tried for entry in entries)
    violated = sum(len(entry.violations) for entry in entries)
    lines.append(f"| all | {tried} | {tried - violated} | {violated} |")
    return "\n".join(lines)


def write(entries: Sequence[Entry], seed: int, file: Path) -> None:
    """Write the entries as JSON."""
    content = {
        "seed": seed,
        "entries": [
            {
                "what": entry.what,
                "tried": entry.tried,
                "held": entry.held,
                "violated": len(entry.violations),
                "violations": entry.violations,
                "remarks": entry.remarks,
                "skipped": entry.skipped,
                "seconds": round(entry.seconds, 1),
            }
            for entry in entries
        ],
    }
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(content, indent=1, ensure_ascii=True) + "\n")
