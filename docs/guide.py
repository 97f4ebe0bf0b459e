"""Run the commands of README.md and of the guide's pages, as their reader would.

`python -m docs.guide docs/howto/sweeps.md` runs those of a page in an empty folder and writes their
outputs into it. Tests run every page so and compare (`tests/test_guide.py`). On a page,

- blocks of `console` hold commands (`$ `, continued by a backslash) and their outputs, in which a
  line `...` stands for any lines; without an output only the exit code is compared;
- other blocks that begin with `# PATH` or `% PATH` are files, written to the folder;
- `<!-- run: COMMAND -->` is a command that is not shown;
- `<!-- test: NOTE; NOTE -->` before a block says how it is run: `A -> B` replaces text of its
  commands, which makes a long sweep short, `A => B` a name that stands for the reader's own, `dry`
  adds `dry_run=true`, `loose` ignores the numbers of the outputs, `exit 2` expects that code,
  `stderr` compares both streams, `needs NAME` leaves out the rest of the page where a program, a
  package or a variable is missing, `skip: REASON` does not run the block.

`make TARGET` is asked of make for its recipe (`--dry-run`), in the checkout.
"""

import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

ROOT = Path(__file__).parents[1]
LONGEST_S = 600.0  # of one command
PART = re.compile(
    r"<!-- run: (?P<run>.+?) -->\n"
    r"|(?:<!-- test: (?P<notes>.+?) -->\n)?^```(?P<kind>\w+)\n(?P<body>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
FILE = re.compile(r"[#%] ([\w./-]+\.\w+)\n")
COMMAND = re.compile(r"^\$ ((?:.*\\\n)*.*)\n?", re.MULTILINE)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
TIME = re.compile(r"\d\d:\d\d:\d\d|\d{4}-\d\d-\d\d( \d\d:\d\d)?")
REPLACED = re.compile(r"(?P<old>.+) (?P<arrow>->|=>) (?P<new>.+)")
MARKS = re.compile(r"\*\*|[†‡§]")
PROGRAMS = {"seatrial": "seatrial.runner", "seatrial-results": "seatrial.runner.compare"}
RESULTS = re.compile(r"seatrial-results [^|&;<>$`*?~]+$")  # without a shell's marks
TOLERANCE = 2e-3  # of a number: other processors round differently


class MismatchError(AssertionError):
    """A command of a page does not do what the page shows."""


@dataclass(frozen=True)
class Step:
    """A command with the output that is shown, or a file that is to be written."""

    line: int
    command: str = ""
    shown: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    file: str = ""
    text: str = ""  # of the file, or of the block of commands
    written: str = ""  # the command as it stands on the page

    def asked(self, full: bool) -> str:
        """The command that is run: a short one in place of a long one, unless `full`."""
        command = self.command
        if command.startswith("make "):
            return f"make --dry-run --directory {ROOT} {command[5:]}"
        for note in self.notes:
            found = REPLACED.fullmatch(note)
            if not found or (full and found["arrow"] == "->"):
                continue
            old = found["old"]
            if old not in self.text:  # of the block
                raise MismatchError(f"line {self.line}: {old!r} is to be replaced and is not there")
            command = command.replace(old, found["new"])
        return f"{command} dry_run=true" if "dry" in self.notes and not full else command

    @property
    def code(self) -> int:
        """The exit code that is expected."""
        return next((int(note[5:]) for note in self.notes if note.startswith("exit ")), 0)


def pages() -> list[Path]:
    """README.md and every page of the guide that has commands of its own."""
    found = [*ROOT.glob("docs/tutorials/*.md"), *ROOT.glob("docs/howto/*.md")]
    return [ROOT / "README.md", *sorted(found)]


def steps(text: str) -> Iterator[Step]:
    """The files and commands of a page, in order."""
    for part in PART.finditer(text):
        line = text.count("\n", 0, part.start()) + 1
        if part["run"]:
            yield Step(line, part["run"])
            continue
        notes = tuple(note.strip() for note in (part["notes"] or "").split(";") if note.strip())
        body = part["body"]
        if part["kind"] != "console":
            if name := FILE.match(body):
                yield Step(line, notes=notes, file=name[1], text=body[name.end() :])
            continue
        commands = list(COMMAND.finditer(body))
        ends = [command.start() for command in commands[1:]] + [len(body)]
        for command, end in zip(commands, ends, strict=True):
            shown = tuple(body[command.end() : end].splitlines())
            at = line + body.count("\n", 0, command.start()) + (2 if part["notes"] else 1)
            plain = command[1].replace("\\\n", " ")
            yield Step(at, plain, shown, notes, text=body, written=command[0])


class Folder:
    """An empty folder with the two programs as they are when installed."""

    def __init__(self, path: Path) -> None:
        self.path = path / "work"
        self.path.mkdir()
        programs = path / "bin"
        programs.mkdir()
        texts = {
            name: f"#!{sys.executable}\nimport sys\n\nfrom {module}.__main__ import main\n\n"
            "sys.exit(main())\n"
            for name, module in PROGRAMS.items()
        }
        texts["python"] = f'#!/bin/sh\nexec {sys.executable} "$@"\n'
        for name, text in texts.items():
            (programs / name).write_text(text)
            (programs / name).chmod(0o755)
        around = {name: value for name, value in os.environ.items() if name != "HYDRA_FULL_ERROR"}
        path_of = os.pathsep.join([str(programs), os.environ["PATH"]])
        self.environment = {
            **around, "PATH": path_of, "PYTHONPATH": str(ROOT), "COLUMNS": "100", "NO_COLOR": "1",
            "DATA": os.environ.get("SEATRIAL_DATA", ""),
        }  # fmt: skip

    def run(self, step: Step, full: bool = False) -> tuple[int, list[str], str]:
        """Exit code, lines of output and standard error of a command."""
        command = step.asked(full)
        if command.startswith("export "):
            name, _, value = command[7:].partition("=")
            self.environment[name] = value
            return 0, [], ""
        both = bool(step.code or "stderr" in step.notes)
        is_plain = RESULTS.match(command) and "SEATRIAL_PLUGINS" not in self.environment
        code, out, err = (self._in_process if is_plain else self._by_shell)(command, both)
        if data := self.environment["DATA"]:
            out = out.replace(data, "$DATA")
        lines = out.splitlines()
        if both:  # progress and warnings begin with the time
            lines = [line for line in lines if not re.match(r"\d\d:\d\d:\d\d ", line)]
        return code, lines, err or out

    def _by_shell(self, command: str, both: bool) -> tuple[int, str, str]:
        """Exit code, output and standard error, which is in the output if `both`."""
        done = subprocess.run(
            ["bash", "-o", "pipefail", "-c", command], cwd=self.path, env=self.environment,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT if both else subprocess.PIPE,
            text=True, timeout=LONGEST_S, check=False, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        return done.returncode, done.stdout, done.stderr or ""

    def _in_process(self, command: str, both: bool) -> tuple[int, str, str]:
        """The same of a plain command of `seatrial-results`, without starting a program."""
        from seatrial.runner.compare.__main__ import run

        words = shlex.split(command.replace("\\\n", " "))
        out, err = io.StringIO(), io.StringIO()
        with (
            chdir(self.path), redirect_stdout(out), redirect_stderr(out if both else err),
            mock.patch.dict(os.environ, self.environment, clear=True),
            mock.patch.object(sys, "orig_argv", [sys.executable, *words]),
            warnings.catch_warnings(),
        ):  # fmt: skip
            warnings.simplefilter("ignore")
            code = run(words[1:])
        return code, out.getvalue(), err.getvalue()

    def lacks(self, step: Step) -> str:
        """The program, package or variable that a step needs and that is not here."""
        needed = [note[6:] for note in step.notes if note.startswith("needs ")]
        for name in needed:
            if not (name in os.environ or shutil.which(name) or find_spec(name)):
                return name
        return ""


def check(text: str, folder: Folder) -> str:
    """Run the steps of a page; return what is missing here for the rest of it, or nothing.

    Raises MismatchError at the first command that does not do what is shown.
    """
    for step in steps(text):
        if lacking := folder.lacks(step):
            return f"{lacking} is not here"
        if any(note.startswith("skip:") for note in step.notes):
            continue
        if step.file:
            write(folder, step)
            continue
        code, lines, error = folder.run(step)
        if code != step.code:
            end = "\n".join(error.splitlines()[-15:])
            raise MismatchError(f"line {step.line}: {step.command}\nexit code {code}\n{end}")
        loose = "loose" in step.notes or any(" -> " in note for note in step.notes)
        if step.shown and not agree(step.shown, lines, loose):
            shown, real = "\n".join(step.shown), "\n".join(lines)
            raise MismatchError(f"line {step.line}: {step.command}\nshown:\n{shown}\nis:\n{real}")
    return ""


def write(folder: Folder, step: Step) -> None:
    """Write a file of a page."""
    path = folder.path / step.file
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(step.text)


def agree(shown: Sequence[str], lines: Sequence[str], loose: bool = False) -> bool:
    """Whether lines are those that are shown, `...` standing for any number of them."""
    lines = [line for line in lines if line.strip()]
    wanted = [line for line in shown if line.strip()]
    if not wanted:
        return not lines
    if wanted[0].strip() == "...":
        return any(agree(wanted[1:], lines[i:], loose) for i in range(len(lines) + 1))
    return bool(lines) and same(wanted[0], lines[0], loose) and agree(wanted[1:], lines[1:], loose)


def same(shown: str, line: str, loose: bool) -> bool:
    """Whether two lines have the same words, and numbers that agree."""
    one, other = (TIME.sub("time", text) for text in (shown, line))
    if loose:
        one, other = MARKS.sub("", one), MARKS.sub("", other)
    frames = [re.sub(r"[─┄]+", "─", NUMBER.sub("#", text)).split() for text in (one, other)]
    if frames[0] != frames[1]:
        return False
    numbers = [list(map(float, NUMBER.findall(text))) for text in (one, other)]
    pairs = zip(*numbers, strict=True)
    return loose or all(abs(a - b) <= TOLERANCE * max(abs(a), abs(b)) for a, b in pairs)


def updated(text: str, folder: Folder, full: bool) -> str:
    """The page with the outputs of its commands; `?` in place of an output asks for all of it."""
    at = 0
    for step in list(steps(text)):
        if any(note.startswith("skip:") for note in step.notes) or folder.lacks(step):
            continue
        if step.file:
            write(folder, step)
            continue
        code, lines, error = folder.run(step, full and bool(step.shown))
        print(f"line {step.line}: {code} {step.command}", flush=True)
        if code != step.code:
            print(error, flush=True)
            continue
        if step.shown:
            shown, new = "\n".join(step.shown) + "\n", "\n".join(shortened(step.shown, lines))
            at = text.index(step.written, at) + len(step.written)
            text = text[:at] + new.rstrip() + "\n" + text[at + len(shown) :]
    return text


def shortened(shown: Sequence[str], lines: Sequence[str]) -> list[str]:
    """The lines, with as many before and after `...` as are shown now."""
    if "..." not in shown:
        return [line.rstrip() for line in lines]
    first, last = shown.index("..."), len(shown) - 1 - shown[::-1].index("...")
    after = list(lines[len(lines) - (len(shown) - 1 - last) :]) if last < len(shown) - 1 else []
    return [line.rstrip() for line in [*lines[:first], "...", *after]]


if __name__ == "__main__":
    for name in sys.argv[1:]:
        page = Path(name)
        with TemporaryDirectory() as empty:
            page.write_text(updated(page.read_text(), Folder(Path(empty)), full=True))
