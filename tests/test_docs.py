"""The documentation: its Python compiles, the first example of a reader runs, its links lead somewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from test_project import FORBIDDEN_TEXT

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
FIRST = [ROOT / "README.md", ROOT / "docs" / "index.md"]  # whose Python is run, not only compiled

_BLOCK = re.compile(r"^```python\n(.*?)^```$", re.DOTALL | re.MULTILINE)
_FENCED = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
_CODE = re.compile(r"`[^`\n]*`")
_LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
_HEADING = re.compile(r"^#+ +(.*?) *$", re.MULTILINE)
_ABSOLUTE = re.compile(r"(?<![\w.~$})\]<-])/(?:[\w.-]+/)|\b[A-Z]:\\")


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def blocks(path: Path) -> list[str]:
    """Python blocks of a page, on the lines that they have there."""
    text = path.read_text(encoding="utf-8")
    return ["\n" * text.count("\n", 0, match.start(1)) + match[1] for match in _BLOCK.finditer(text)]


def prose(path: Path) -> str:
    """A page without its code."""
    return _CODE.sub("", _FENCED.sub("", path.read_text(encoding="utf-8")))


def anchors(path: Path) -> set[str]:
    """Anchors of a page's headings, as they are made where it is shown."""
    text = _FENCED.sub("", path.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in _HEADING.findall(text)}


def test_the_index_has_python():
    assert len(blocks(ROOT / "docs" / "index.md")) == 1
    assert sum(bool(blocks(path)) for path in PAGES) >= 3


@pytest.mark.parametrize("path", PAGES, ids=name)
def test_python_compiles(path):
    for block in blocks(path):
        compile(block, name(path), "exec")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "number"),
    [pytest.param(path, i, id=f"{name(path)}-{i}") for path in FIRST for i in range(len(blocks(path)))],
)
def test_first_example_runs(path, number, tmp_path):
    """As a reader would paste it, in a folder of its own."""
    answer = subprocess.run(
        [sys.executable, "-W", "error", "-c", blocks(path)[number]],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert answer.returncode == 0, answer.stderr
    assert answer.stderr == ""


@pytest.mark.parametrize("path", PAGES, ids=name)
def test_links_lead_somewhere(path):
    lost = []
    for link in _LINK.findall(prose(path)):
        if re.match(r"\w+:", link):
            continue
        file, _, anchor = link.partition("#")
        target = (path.parent / file) if file else path
        if not target.exists() or (anchor and anchor not in anchors(target)):
            lost.append(link)
    assert lost == []


def test_every_page_is_in_the_index():
    linked = set(_LINK.findall(prose(ROOT / "docs" / "index.md")))
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in PAGES if path.parent != ROOT}
    assert pages - {"index.md"} - linked == set()


@pytest.mark.parametrize("path", PAGES, ids=name)
def test_no_absolute_paths_and_no_registries(path):
    lines = enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
    assert [(number, line) for number, line in lines if FORBIDDEN_TEXT.search(line) or _ABSOLUTE.search(line)] == []
