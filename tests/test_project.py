"""Rules of the project that no linter knows, read off the syntax trees and the tracked files."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "leanboom"
SOURCES = sorted(PACKAGE.rglob("*.py"))
MAX_LINES = 500
MOST_MODULES = 11  # of a folder
COMPILERS = {"njit", "jit", "vectorize", "guvectorize", "cfunc"}
HEAVY = ("numba", "casadi", "maptor", "plotly", "pint", "matplotlib", "jinja2", "psutil")

# In two parts, or this file would be its own first finding.
HOSTS = (
    "pypi" + r"\.org",
    "pythonhosted" + r"\.org",
    "npmjs" + r"\.(org|com)",
    "debian" + r"\.org",
    "crates" + r"\.io",
    "proxy\\.golang" + r"\.org",
    "anaconda" + r"\.(org|com)",
)
FOLDERS = ("wo" + "rk", "tm" + "p", "ro" + "ot", "ho" + "me")
FORBIDDEN_TEXT = re.compile("|".join([*HOSTS, rf"(?<![\w.~$}})\]-])/(?:{'|'.join(FOLDERS)})/"]))

Function = ast.FunctionDef | ast.AsyncFunctionDef
Definition = Function | ast.ClassDef


def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), str(path))


def _where(path: Path, node: Definition) -> str:
    return f"{path.relative_to(ROOT)}:{node.lineno}: {node.name}"


def _public_definitions(body: list[ast.stmt]) -> Iterator[Definition]:
    """Public classes, functions and methods, not what is local to a function."""
    for node in body:
        if isinstance(node, Definition) and not node.name.startswith("_"):
            yield node
            if isinstance(node, ast.ClassDef):
                yield from _public_definitions(node.body)


def _parameters(function: Function) -> list[str]:
    arguments = function.args
    named = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
    named += [argument for argument in (arguments.vararg, arguments.kwarg) if argument]
    return [argument.arg for argument in named if argument.arg not in {"self", "cls"}]


def _compiler_options(function: Function) -> Iterator[dict[str, ast.expr]]:
    """Keyword arguments of each numba decorator of a function."""
    for decorator in function.decorator_list:
        called = decorator.func if isinstance(decorator, ast.Call) else decorator
        name = called.attr if isinstance(called, ast.Attribute) else getattr(called, "id", None)
        if name in COMPILERS:
            keywords = decorator.keywords if isinstance(decorator, ast.Call) else []
            yield {keyword.arg: keyword.value for keyword in keywords if keyword.arg}


def _tracked_texts() -> Iterator[tuple[str, str]]:
    """Name and text of every file that is, or without more ado would be, in version control."""
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in sorted(filter(None, names.split("\0"))):
        path = ROOT / name
        if not path.is_file():
            continue  # deleted, not yet in the index
        content = path.read_bytes()
        if b"\0" not in content:
            yield name, content.decode("utf-8")


def _kernel_mistakes(path: Path) -> list[str]:
    """Numba decorators of a file without a disk cache, or with fastmath, which breaks isnan and isinf."""
    mistakes = []
    for node in ast.walk(_tree(path)):
        if not isinstance(node, Function):
            continue
        for options in _compiler_options(node):
            cache = options.get("cache")
            if not (isinstance(cache, ast.Constant) and cache.value is True):
                mistakes.append(f"{_where(path, node)}: cache=True is missing")
            if "fastmath" in options:
                mistakes.append(f"{_where(path, node)}: fastmath is not for kernels that test for nan and inf")
    return mistakes


def test_the_package_is_found():
    """The other tests would pass on no files at all."""
    assert SOURCES


def test_kernels_are_cached_and_keep_infinities():
    assert [mistake for path in SOURCES for mistake in _kernel_mistakes(path)] == []


@pytest.mark.parametrize("decorator", ["@njit", "@njit(cache=False)", "@numba.njit(cache=True, fastmath=True)"])
def test_a_kernel_without_cache_or_with_fastmath_is_found(tmp_path, monkeypatch, decorator):
    monkeypatch.setattr(sys.modules[__name__], "ROOT", tmp_path)
    path = tmp_path / "kernels.py"
    path.write_text(f"{decorator}\ndef f(x):\n    return x\n", encoding="utf-8")
    assert len(_kernel_mistakes(path)) == 1


def test_only_one_module_takes_decorators_from_numba():
    """Every kernel takes `njit` from `compiling`, whose folder of compiled code belongs to the sources at hand."""
    found = [
        path.name
        for path in SOURCES
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.ImportFrom)
        and (node.module or "").split(".")[0] == "numba"
        and COMPILERS & {alias.name for alias in node.names}
        or isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "numba"
        and node.attr in COMPILERS
    ]
    assert found == ["compiling.py"]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_public_names_are_documented(path):
    tree = _tree(path)
    missing = [] if ast.get_docstring(tree) or path.stem.startswith("_") else [f"{path.name}: module"]
    for node in _public_definitions(tree.body):
        text = ast.get_docstring(node)
        if not text:
            missing.append(_where(path, node))
        elif isinstance(node, Function) and "Args:" in text.splitlines():
            described = text.split("Args:\n", 1)[1]
            missing += [
                f"{_where(path, node)}: argument {name}"
                for name in _parameters(node)
                if not re.search(rf"^ +(?:\w+, )*\*{{0,2}}{name}\b[^:\n]*:", described, re.MULTILINE)
            ]
    assert missing == []


def test_no_file_is_long():
    """A longer one is split by idea."""
    found = {p.name: n for p in SOURCES if (n := len(p.read_text(encoding="utf-8").splitlines())) > MAX_LINES}
    assert found == {}


def test_no_module_is_a_drawer():
    drawers = {"util", "utils", "utilities", "helper", "helpers", "common", "core", "misc"}
    assert [path.name for path in PACKAGE.rglob("*") if path.stem.strip("_") in drawers] == []


def test_every_folder_is_a_chapter_of_few_modules():
    """A stranger sees the architecture from the list of folders."""
    folders = [path for path in PACKAGE.rglob("*") if path.is_dir() and any(path.glob("*.py"))]
    assert {"certificate", "evaluation", "formulas", "model", "planning"} < {path.name for path in folders}
    undescribed = [path.name for path in folders if not ast.get_docstring(_tree(path / "__init__.py"))]
    crowded = {path.name: n for path in folders if (n := len(list(path.glob("*.py"))) - 1) > MOST_MODULES}
    assert (undescribed, crowded) == ([], {})


def test_markup_of_pages_stands_in_templates_alone():
    """Where Python builds HTML, one forgotten call lets a text from a file become markup."""
    found = [
        f"{path.name}:{node.lineno}"
        for path in (PACKAGE / "report").glob("*.py")
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and re.search(r"</?[a-z]+[ >]", node.value)
    ]
    assert found == []


@pytest.mark.parametrize("names", ["constant_pressure", "driven_velocity", "bore|piston_area|rod_side_area"])
def test_few_modules_beside_the_model_know_a_quantity_of_the_machine(names):
    """All others ask `model` or `components` for what follows from it."""
    others = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] not in {"components", "model"}]
    found = [path.name for path in others if re.search(rf"\b({names})\b", path.read_text(encoding="utf-8"))]
    assert 0 < len(found) <= 5, found


def test_importing_the_package_loads_nothing_heavy():
    program = f"import sys, leanboom; print(*sorted(set({HEAVY!r}) & set(sys.modules)))"
    answer = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert answer.stdout.split() == []


def test_no_text_names_a_registry_or_a_folder_of_one_machine():
    found = [
        f"{name}:{number}: {match.group()}"
        for name, text in _tracked_texts()
        for number, line in enumerate(text.splitlines(), 1)
        for match in FORBIDDEN_TEXT.finditer(line)
    ]
    assert found == []


def test_the_lock_holds_hashes_and_no_addresses():
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert "htt" + "p" not in lock
    assert "--index" not in lock and "--find-links" not in lock
    entries = re.split(r"\n(?=\w)", lock)
    assert [entry.split()[0] for entry in entries if "--hash=sha256:" not in entry] == []


def test_the_lock_covers_every_declared_package():
    """A package declared without renewing the lock would be missing from a fresh environment."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    groups = project["dependency-groups"].values()
    declared = [*project["project"]["dependencies"], *(entry for group in groups for entry in group)]
    names = {re.split(r"[^\w.-]", entry)[0].lower().replace(".", "-").replace("_", "-") for entry in declared}
    lock = (ROOT / "requirements.lock").read_text(encoding="utf-8")
    assert names - set(re.findall(r"^([\w-]+)==", lock, re.MULTILINE)) == set()
