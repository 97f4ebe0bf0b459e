"""Update the generated blocks of README.md, CONTRIBUTING.md and the guide: `make readme`.

`python docs/refresh.py WORD` updates only some of them.

Every block between `<!-- made by: COMMAND -->` and `<!-- end -->` is replaced by the output of its
command; with a WORD, only blocks whose command contains it. Without one, a block whose results are
not there stays as it is. The commands read the results of `make demo`, `make published`,
`make bench`, `make robustness`, `make coverage`, `make bands`, `make docking`, `make manoeuvring`
and `make benchmark`.
"""

import re
import shlex
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCUMENTS = (*sorted(ROOT.glob("*.md")), *sorted(ROOT.glob("docs/**/*.md")))
BLOCK = re.compile(r"(<!-- made by: (?P<command>.+?) -->\n).*?(<!-- end -->)", re.DOTALL)


def output(command: str, *more: str) -> str:
    """The output of a `python -m ...` command."""
    words = [sys.executable if word == "python" else word for word in shlex.split(command)]
    done = subprocess.run([*words, *more], capture_output=True, text=True, check=True, cwd=ROOT)
    return done.stdout


def refreshed(text: str, word: str = "") -> str:
    """The text with updated blocks, if their command contains `word`."""

    def block(found: re.Match[str]) -> str:
        if word not in found["command"]:
            return found[0]
        try:
            return f"{found[1]}\n{output(found['command'])}\n{found[3]}"
        except subprocess.CalledProcessError as error:
            if word:
                raise
            print(f"{found['command']}: left as it is: {error.stderr.strip()}", file=sys.stderr)
            return found[0]

    return BLOCK.sub(block, text)


if __name__ == "__main__":
    for page in DOCUMENTS:
        text = page.read_text()
        if (updated := refreshed(text, *sys.argv[1:2])) != text:
            page.write_text(updated)
