"""Names that benchmarks and examples import from cagemap exist, also where their other libraries are not installed."""

import ast
import importlib
import importlib.util
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

REPOSITORY = Path(__file__).resolve().parents[2]


def _exists(module: str, name: str) -> bool:
    try:
        return hasattr(importlib.import_module(module), name) or bool(importlib.util.find_spec(f"{module}.{name}"))
    except ModuleNotFoundError:
        return False


def _missing_names(path: Path) -> list[str]:
    missing = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "cagemap":
            for alias in node.names:
                if not _exists(node.module, alias.name):
                    missing.append(f"{path.relative_to(REPOSITORY)}:{node.lineno}: {node.module}.{alias.name}")
    return missing


def test_benchmarks_and_examples_import_names_that_exist() -> None:
    files = [path for folder in ("benchmarks", "examples") for path in sorted((REPOSITORY / folder).rglob("*.py"))]
    assert len(files) > 50
    assert [name for path in files for name in _missing_names(path)] == []
