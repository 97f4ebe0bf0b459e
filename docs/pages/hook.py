"""The hook of mkdocs.yml: fills the pages of the guide with what the source says of itself.

A line `<!-- insert: NAME ARGUMENTS -->` of a page is replaced by the text of `INSERTS[NAME]`, so
that names, units, defaults and help stand once, in the source. The figures of the gallery and of
the database are added to the site, and the pages beside README.md, so that links reach them.
"""

import re
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from docs import gallery
from docs.pages import commands, database, lists, metrics, options

ROOT = Path(__file__).parents[2]
ROOT_PAGES = ("CONTRIBUTING.md", "CHANGELOG.md", "SECURITY.md")
INSERT = re.compile(r"^<!-- insert: (?P<words>.+?) -->$", re.MULTILINE)
INSERTS: Mapping[str, Callable[..., str]] = {
    "benchmark": lists.benchmark,
    "commands": commands.commands,
    "database": database.tables,
    "experiments": lists.experiments,
    "gallery": gallery.page,
    "metrics": metrics.table,
    "options": options.group,
    "parts": lists.parts,
    "trial": options.trial,
    "vessel_lines": lists.vessel_lines,
    "vessel_class": options.vessel_class,
}
_copy = tempfile.TemporaryDirectory(prefix="seatrial-guide-")


@event_priority(100)  # before mkdocstrings reads its options
def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Show mkdocstrings, which follows no links, the package as it is when installed."""
    package = Path(_copy.name) / "seatrial"
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "seatrial", package, ignore=ignored, dirs_exist_ok=True)
    handlers = config.plugins["mkdocstrings"].config.handlers
    handlers["python"]["paths"] = [str(package.parent)]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the figures that are drawn, and the pages beside README.md."""
    for name in ROOT_PAGES:
        text = (ROOT / name).read_text().replace("](docs/", "](")
        files.append(File.generated(config, name, content=text))
    files.append(File.generated(config, database.FIGURE, content=database.drawn()))
    for path in gallery.drawn():
        files.append(File.generated(config, f"gallery/{path.name}", abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Fill the inserts, and turn links out of the guide to the pages beside README.md."""
    filled = INSERT.sub(lambda found: _insert(found["words"].split()), markdown)
    up = "../" * page.file.src_uri.count("/")
    for name in ROOT_PAGES:
        filled = filled.replace(f"]({up}../{name}", f"]({up}{name}")
    return filled


def _insert(words: list[str]) -> str:
    name, *arguments = words
    return INSERTS[name](*arguments)
