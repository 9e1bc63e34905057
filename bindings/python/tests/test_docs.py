"""Code blocks of docs/python.md, and the examples that need neither Ray nor Dask."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib
import pytest

import cfmmr.algorithms

ROOT = Path(__file__).resolve().parents[3]
EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
PAGE = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")


def blocks(language):
    """Text of each code block with its line in the page; lines before a block keep its traceback's numbers right."""
    for match in re.finditer(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL):
        yield "\n" * PAGE[: match.start(1)].count("\n") + match[1]


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """Printed text of each python block, run in the order of the page in one namespace."""
    matplotlib.use("Agg")
    folder, here = tmp_path_factory.mktemp("page"), Path.cwd()
    namespace, texts = {"__name__": "page"}, []
    namespace["print"] = lambda *values, sep=" ": texts[-1].append(sep.join(map(str, values)))
    os.chdir(folder)
    try:
        for block in blocks("python"):
            texts.append([])
            exec(compile(block, "docs/python.md", "exec"), namespace)
    finally:
        os.chdir(here)
    assert {"path.png", "figure-7.png", "figure-8.png"} <= {file.name for file in folder.iterdir()}
    return ["\n".join(lines) for lines in texts]


def test_page_prints_the_text_that_it_shows(printed):
    (shown,) = blocks("text")
    assert printed[0] == shown.strip()


def test_rows_of_table_1_are_those_of_the_program(printed, program, tmp_path):
    arguments = ["paper", "--trials", "50", "--seed", "31", "--out", tmp_path]
    assert f"`cfmmr {' '.join(arguments[:5])}`" in PAGE
    text = subprocess.run([program, *arguments], check=True, capture_output=True, text=True).stdout
    rows = [re.split(r"\s{2,}", line)[1:] for line in text.splitlines() if ", simulated" in line and "±" in line]
    assert len(rows) == 2
    assert [line.split(" | ")[1:] for line in printed[0].splitlines()] == rows


def test_loop_taken_apart_ends_as_the_run(printed):
    run, apart = (re.search(r"goal error \d+\.\d cm", printed[k])[0] for k in (1, 3))
    assert run == apart


def test_executor_keeps_every_bit(printed):
    assert "True" in printed and "False" not in printed


def test_every_block_prints(printed):
    assert len(printed) == PAGE.count("```python\n") > 8 and all(printed)


def test_table_of_algorithms_names_all():
    table = PAGE.split("## Algorithms")[1].split("\n## ")[0]
    assert sorted(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) == sorted(cfmmr.algorithms.__all__)


def example(name):
    command = [sys.executable, EXAMPLES / name]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()


@pytest.mark.parametrize("name", ["own_controller.py", "own_estimator.py"])
def test_own_part_reaches_the_goal(name):
    built_in, own = (float(re.search(r"goal error (\d+\.\d) ±", line)[1]) for line in example(name))
    assert built_in < own < 2 * built_in


def test_notebook_runs_without_stored_outputs():
    notebook = json.loads((EXAMPLES / "paper.ipynb").read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert not any(cell["outputs"] or cell["execution_count"] for cell in cells)
    matplotlib.use("Agg")
    namespace = {}
    for cell in cells:
        lines = (line for line in cell["source"] if not line.startswith("%"))
        exec("".join(lines), namespace)
    assert namespace["printed"].loc["odometry", "e (cm)"] > 0
