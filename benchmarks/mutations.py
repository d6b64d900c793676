"""``python -m benchmarks.mutations --output FILE``: random mutations of src, and which of them the fast tests catch.

Needs cosmic-ray and pytest-cov (``pip install ".[bench,test]"``). Mutations are made in a copy of the last commit. The
fast tests run once to learn which test executes which line (FILE.coverage, kept). A mutation then runs the tests that
execute its line: those of the package's own folder first, and of these the ones that execute the fewest lines of src.
Lines that coverage does not see (compiled kernels, what runs at import) run their own folder, then all fast tests. Rows
are written as they come, and what is there is not done again. Mutations of annotations, messages, docstrings,
decorators and `strict` are not made. Figures: docs/lab/tests.md.
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import random
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator
from coverage import CoverageData

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
PROCESSOR_SECONDS = 900  # of one run of tests; a mutation may loop for ever


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
        executed = executed_lines(copy, arguments.output.with_suffix(".coverage").absolute())
        counts = line_counts(executed)
        chosen = mutations(copy, random.Random(arguments.seed))
        for number in range(arguments.count):
            path, change, places, mutated = next(chosen)
            if number < len(done):
                continue
            stages = tests_of(copy, executed, counts, path, places)
            row = {"file": str(path), "change": change, "caught": caught(copy, path, mutated, stages)}
            lines.write(json.dumps(row) + "\n")
            lines.flush()
            print(row["caught"] or "SURVIVED", path, *change, sep="\n  ", flush=True)
    rows = [json.loads(line) for line in arguments.output.read_text().splitlines()]
    print(f"{sum(bool(row['caught']) for row in rows)} of {len(rows)} caught")


def executed_lines(copy: Path, file: Path) -> CoverageData:
    """Which test executes which line, from a file of an earlier run of the same commit if there is one."""
    if not file.is_file():
        configuration = copy.parent / "coveragerc"
        configuration.write_text(f"[run]\nsource = {SOURCE}\nrelative_files = true\ndata_file = {file}\n")
        coverage = ["--cov", f"--cov-config={configuration}", "--cov-context=test", "--cov-report="]
        subprocess.run([sys.executable, "-m", "pytest", "-q", *coverage], cwd=copy, env=environment(copy), check=True)
    data = CoverageData(str(file))
    data.read()
    return data


def line_counts(executed: CoverageData) -> Counter[str]:
    """How many lines of src each test executes."""
    lines = (executed.contexts_by_lineno(file).values() for file in executed.measured_files())
    contexts = chain.from_iterable(chain.from_iterable(lines))
    return Counter(context.partition("|")[0] for context in contexts)


def mutations(copy: Path, choice: random.Random) -> Iterator[tuple[Path, list[str], list[int], str]]:
    """File, changed lines, their numbers and mutated text; files are drawn in proportion to their lines."""
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
        places = [i for i, (old, new) in enumerate(zip(before, after, strict=False)) if old != new]
        change = [f"- {before[i].strip()}\n  + {after[i].strip()}" for i in places]
        if change and stripped(mutated) not in ("", stripped(texts[path])):
            yield path, change, [i + 1 for i in places], mutated


class _Stripped(ast.NodeTransformer):
    """A module without what no test need see: annotations, docstrings, messages, how kernels are compiled, `strict`."""

    def visit_arg(self, node: ast.arg) -> ast.arg:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant(None)
        return self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns, node.decorator_list = None, []
        return self.generic_visit(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        node.decorator_list = []
        return self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> ast.AST:
        if node.arg == "strict":
            node.value = ast.Constant(True)
        return self.generic_visit(node)

    def visit_JoinedStr(self, node: ast.JoinedStr) -> ast.AST:
        return ast.Constant("")


def stripped(text: str) -> str:
    """The syntax of a module as far as mutations of it count; empty if the text is no Python."""
    try:
        return ast.dump(_Stripped().visit(ast.parse(text)))
    except SyntaxError:
        return ""


def tests_of(copy: Path, executed: CoverageData, counts: Counter[str], path: Path, lines: list[int]) -> list[list[str]]:
    """Tests to run for a change of some lines of a file, in stages: until one fails."""
    own = str(Path("tests", path.relative_to(SOURCE).parts[0].removesuffix(".py")))
    tree = ast.parse((copy / path).read_text(encoding="utf-8"))
    functions = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
    contexts = executed.contexts_by_lineno(str(path))
    tests = set()
    for line in lines:
        if any(node.body[0].lineno <= line <= (node.end_lineno or 0) for node in functions):
            for context in contexts.get(line, []):
                test, _, phase = context.partition("|")
                tests.add(test.partition("::")[0] if phase == "setup" else test)  # a fixture is its whole file's
    tests.discard("")
    if tests:
        # Whole files have no count.
        return [sorted(tests, key=lambda test: (not test.startswith(own + "/"), "::" not in test, counts[test], test))]
    return [*([[own]] if (copy / own).is_dir() else []), ["tests"]]


def caught(copy: Path, path: Path, mutated: str, stages: list[list[str]]) -> str:
    """The test that fails with a mutation, or what else ended the tests; empty if none does."""
    whole = (copy / path).read_text(encoding="utf-8")
    try:
        (copy / path).write_text(mutated, encoding="utf-8")
        return next(filter(None, (failure(copy, tests) for tests in stages)), "")
    finally:
        (copy / path).write_text(whole, encoding="utf-8")


def environment(copy: Path) -> dict[str, str]:
    """Tests of the copy, not of what is installed."""
    return os.environ | {"PYTHONPATH": str(copy / "src")}


def failure(copy: Path, tests: list[str]) -> str:
    """First of some tests that fails."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider", *tests]
    limit = (PROCESSOR_SECONDS, PROCESSOR_SECONDS)
    run = subprocess.run(
        command,
        cwd=copy,
        env=environment(copy),
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, limit),
    )
    failed = [line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return "" if run.returncode == 0 else (failed or [f"exit code {run.returncode}"])[0]


if __name__ == "__main__":
    main()
