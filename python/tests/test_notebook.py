"""The notebook runs, and holds its results with a picture."""

import ast
import json
from pathlib import Path

import pytest

NOTEBOOK = Path(__file__).parents[1] / "examples" / "tour.ipynb"


def results(cell):
    """The last expression of a cell beside what it gave when the notebook was written."""
    for output in cell["outputs"]:
        if output["output_type"] == "execute_result":
            yield output["data"]


@pytest.fixture(scope="module")
def cells():
    notebook = json.loads(NOTEBOOK.read_text())
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def test_cells_run_in_order(cells, capsys):
    space, compared = {}, 0
    for number, cell in enumerate(cells):
        assert cell["execution_count"] == number + 1, "run all cells of the notebook, in order"
        code = ast.parse("".join(cell["source"]))
        last = code.body.pop() if code.body and isinstance(code.body[-1], ast.Expr) else None
        exec(compile(code, f"cell {number}", "exec"), space)
        value = eval(compile(ast.Expression(last.value), f"cell {number}", "eval"), space) if last else None
        for data in results(cell):
            text = "".join(data.get("text/plain", ""))
            if "image/png" not in data:
                # Instruction sets may differ in the last bits; shapes and names do not.
                assert type(value) is type(ast.literal_eval(text))
                compared += 1
    assert compared >= 2


def test_it_shows_a_picture(cells):
    pictures = [data["image/png"] for cell in cells for data in results(cell) if "image/png" in data]
    assert len(pictures) == 1 and len(pictures[0]) > 10_000
