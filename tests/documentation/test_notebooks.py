"""The notebooks of examples/ run from a fresh kernel, in an empty folder, and are stored without outputs."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
EXPECTED = {
    "paint": ("true mode 597.0 nm, 95 % interval", r"\d{3}\.\d \[\d{3}\.\d, \d{3}\.\d\] nm"),
    "finger": ("pushed 0.75 mm: 1.", "small finger"),
    "comparison": ("is lit at 40 deg but .* at 30 deg", r"[01]\.\d+ \[-?[01]\.\d+, [01]\.\d+\]"),
}
"""What the outputs must hold."""


def shown(notebook: nbformat.NotebookNode) -> str:
    """Return all that the cells printed or returned as text."""
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    return "\n".join(output.get("text", "") or output.get("data", {}).get("text/plain", "") for output in outputs)


def test_every_notebook_is_tried():
    assert {path.stem for path in EXAMPLES.glob("*.ipynb")} == set(EXPECTED)
    listed = set(re.findall(r"\((\w+)\.ipynb\)", (EXAMPLES / "README.md").read_text(encoding="utf-8")))
    assert listed == set(EXPECTED)


@pytest.mark.parametrize("name", EXPECTED)
def test_a_notebook_is_stored_without_outputs_and_begins_with_what_it_shows(name):
    notebook = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    nbformat.validate(notebook)
    assert notebook.cells[0].cell_type == "markdown"
    assert "This notebook" in notebook.cells[0].source
    assert all(not cell.outputs and cell.execution_count is None for cell in notebook.cells if cell.cell_type == "code")


@pytest.mark.parametrize("name", EXPECTED)
def test_a_notebook_runs(name, tmp_path):
    notebook = nbformat.read(EXAMPLES / f"{name}.ipynb", as_version=4)
    NotebookClient(
        notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    text = shown(notebook)
    for pattern in EXPECTED[name]:
        assert re.search(pattern, text), text
    pictures = [
        o
        for c in notebook.cells
        for o in c.get("outputs", [])
        if {"image/png", "image/svg+xml"} & set(o.get("data", {}))
    ]
    assert pictures
