"""``python -m benchmarks.mutations --output FILE``: random mutations of src, and which of them the fast tests catch.

Needs cosmic-ray (``pip install ".[bench]"``). Mutations are made in a copy of the last commit. The tests of the
package's own folder run first, all others only where these find nothing. Rows are written as they come, and what is
there is not done again. Mutations of annotations, messages and docstrings are not made.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator

ROOT = Path(__file__).resolve().parents[1]
SOURCE = Path("src/cagemap")
# One replacement for each operator: others of the same place tell the same.
OPERATORS = (
    *(
        f"core/ReplaceBinaryOperator_{pair}"
        for pair in ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "Pow_Mul", "Mod_Add")
    ),
    *(
        f"core/ReplaceComparisonOperator_{pair}"
        for pair in ("Eq_NotEq", "NotEq_Eq", "Lt_LtE", "LtE_Gt", "Gt_GtE", "GtE_Lt", "Is_IsNot", "IsNot_Is")
    ),
    "core/ReplaceUnaryOperator_USub_UAdd",
    "core/ReplaceUnaryOperator_Delete_Not",
    "core/ReplaceAndWithOr",
    "core/ReplaceOrWithAnd",
    "core/AddNot",
    "core/ReplaceTrueWithFalse",
    "core/ReplaceFalseWithTrue",
    "core/ReplaceBreakWithContinue",
    "core/ReplaceContinueWithBreak",
    "core/ZeroIterationForLoop",
    "core/NumberReplacer",
)
SECONDS = 900


def main() -> None:
    """Make mutations, run the tests, print the table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mutations", description=__doc__)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--output", type=Path, required=True, help="rows, one JSON object a line")
    arguments = parser.parse_args()
    done = arguments.output.read_text().splitlines() if arguments.output.is_file() else []
    with tempfile.TemporaryDirectory() as folder, arguments.output.open("a") as lines:
        copy = Path(folder, "work", "main")  # as deep as the checkout: tests look for ../shared
        subprocess.run(["git", "clone", "-q", str(ROOT), str(copy)], check=True)
        (copy.parent / "shared").symlink_to(ROOT.parent / "shared")
        chosen = mutations(copy, random.Random(arguments.seed))
        for number in range(arguments.count):
            path, change, mutated = next(chosen)
            if number < len(done):
                continue
            row = {"file": str(path), "change": change, "caught": caught(copy, path, mutated)}
            lines.write(json.dumps(row) + "\n")
            lines.flush()
            print(row["caught"] or "SURVIVED", path, *change, sep="\n  ", flush=True)
    rows = [json.loads(line) for line in arguments.output.read_text().splitlines()]
    print(f"{sum(bool(row['caught']) for row in rows)} of {len(rows)} caught")


def mutations(copy: Path, choice: random.Random) -> Iterator[tuple[Path, list[str], str]]:
    """File, changed lines and mutated text; files in proportion to their lines, places of a file alike."""
    files = sorted(path.relative_to(copy) for path in (copy / SOURCE).rglob("*.py"))
    texts = {path: (copy / path).read_text(encoding="utf-8") for path in files}
    weights = [text.count("\n") for text in texts.values()]
    while True:
        path = choice.choices(files, weights)[0]
        operator, occurrence = get_operator(choice.choice(OPERATORS))(), choice.randrange(40)
        mutated = mutate_code(texts[path], operator, occurrence)
        if mutated is None:
            continue
        before, after = texts[path].splitlines(), mutated.splitlines()
        change = [f"- {old.strip()}\n  + {new.strip()}" for old, new in zip(before, after, strict=False) if old != new]
        if change and ast.dump(stripped(texts[path])) != ast.dump(stripped(mutated)):
            yield path, change, mutated


class _Stripped(ast.NodeTransformer):
    """A module without what no test need see: annotations, docstrings, formatted messages."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant(None)
        return self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        return self.generic_visit(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return ast.Constant("")


def stripped(text: str) -> ast.AST:
    """The syntax of a module as far as mutations of it count; None where it is none any more."""
    return _Stripped().visit(ast.parse(text))


def caught(copy: Path, path: Path, mutated: str) -> str:
    """The test that fails with a mutation, or what else ended the tests; empty if none does."""
    whole = (copy / path).read_text(encoding="utf-8")
    own = Path("tests", path.relative_to(SOURCE).parts[0].removesuffix(".py"))
    try:
        (copy / path).write_text(mutated, encoding="utf-8")
        for folders in ([own] if (copy / own).is_dir() else [], ["tests"]):
            if folders:
                found = failure(copy, [str(folder) for folder in folders])
                if found:
                    return found
    finally:
        (copy / path).write_text(whole, encoding="utf-8")
    return ""


def failure(copy: Path, folders: list[str]) -> str:
    """First failing test of some folders."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", *folders]
    environment = os.environ | {"PYTHONPATH": str(copy / "src"), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        run = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no end within {SECONDS} s"
    failed = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return "" if run.returncode == 0 else (failed or [f"exit code {run.returncode}"])[0]


if __name__ == "__main__":
    main()
