"""What users read has no words of the code's own."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import cagemap

pytestmark = pytest.mark.slow

SOURCE = Path(cagemap.__file__).parent
SHOWN = ("cli", "report", "studio")
STAGES = {"progress", "stages", "tell"}
INNER = re.compile(
    r"hypothes|projection|coarse fit|\breading\b(?! the)|\breadings\b|suspect|anisotrop|stretch energy", re.IGNORECASE
)


def texts(tree: ast.Module) -> Iterator[str]:
    """Strings of a module that are no docstrings."""
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    docs = {id(node.body[0].value) for node in ast.walk(tree) if isinstance(node, documented) and is_text(node.body[0])}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node.value


def is_text(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def stages(tree: ast.Module) -> Iterator[str]:
    """Names of the stages that a module tells."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in STAGES:
            yield from (text.value for text in ast.walk(node) if isinstance(text, ast.Constant) and text.value)


def test_stages_and_pages_are_in_words_of_users() -> None:
    told = 0
    for path in SOURCE.rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        shown = list(stages(tree))
        told += len(shown)
        if path.relative_to(SOURCE).parts[0] in SHOWN:
            shown += texts(tree)
        wrong = [text for text in shown if INNER.search(str(text))]
        assert wrong == [], path
    assert told > 30
