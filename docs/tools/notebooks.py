"""A notebook kept as text (jupytext's percent form), executed, as a page with its outputs.

Outputs are kept in ``.cache`` of the site's tools by a hash of the notebook and of the package, so
that a page is executed anew only where either changed.
"""

from __future__ import annotations

import hashlib
import html
import json
import os
import re
import tempfile
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
KEPT = ROOT / "docs" / "tools" / ".cache"
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
# What of a cell's output is shown, the richest form first.
PLOTLY = "application/vnd.plotly.v1+json"


def page_of(notebook: Path, execute: bool = True) -> str:
    """The notebook as Markdown; without outputs where it is not executed."""
    import jupytext

    cells = (executed(notebook) if execute else jupytext.read(notebook)).cells
    file = f"[{notebook.name}](source/{notebook.name}){{ download }}"
    note = f"*The file: {file}, for Jupyter with jupytext.*"
    body: list[str] = []
    for number, cell in enumerate(cells):
        if cell.cell_type == "markdown":
            body.append(cell.source)
            continue
        if cell.cell_type != "code" or not cell.source.strip():
            continue
        body.append(f"```python\n{cell.source}\n```")
        shown = [_shown(o, f"figure-{number}-{i}") for i, o in enumerate(cell.get("outputs", ()))]
        body += [text for text in shown if text]
    head, *rest = body
    return "\n\n".join([head, note, *rest]) + "\n"


def executed(notebook: Path) -> Any:
    """The notebook with its outputs: those kept, where neither it nor the package changed."""
    import nbformat

    kept = KEPT / f"{notebook.stem}-{_fingerprint(notebook)}.ipynb"
    if kept.is_file():
        return nbformat.read(kept, as_version=4)
    made = run(notebook)
    KEPT.mkdir(exist_ok=True)
    for old in KEPT.glob(f"{notebook.stem}-*.ipynb"):
        old.unlink()
    nbformat.write(made, kept)
    return made


def run(notebook: Path) -> Any:
    """Execute the notebook in an empty folder; a cell that fails raises."""
    import jupytext
    from nbclient import NotebookClient
    from traitlets.config import Config

    private = Config({"KernelManager": {"transport_encryption": "auto"}})
    cells = jupytext.read(notebook)
    with tempfile.TemporaryDirectory() as folder:
        before = {name: os.environ.get(name) for name in THREADS}
        os.environ.update(dict.fromkeys(THREADS, "1"))
        try:
            resources = {"metadata": {"path": folder}}
            return NotebookClient(
                cells, timeout=600, kernel_name="python3", resources=resources, config=private
            ).execute()
        finally:
            for name, value in before.items():
                os.environ.pop(name) if value is None else os.environ.update({name: value})


def _fingerprint(notebook: Path) -> str:
    digest = hashlib.sha256(notebook.read_bytes())
    for tree in ("spiral", "plugins"):
        for file in sorted((ROOT / tree).rglob("*.py")):
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _shown(output: Any, ident: str) -> str:
    """One output as Markdown or HTML: a figure, a table, Markdown, or text."""
    if output.output_type == "stream":
        return _text(output.text) if output.name == "stdout" else ""
    if output.output_type not in ("execute_result", "display_data"):
        return ""
    data = output.data
    if PLOTLY in data:
        return _figure(data[PLOTLY], ident)
    if "text/markdown" in data:
        return f'<div class="output" markdown="1">\n\n{data["text/markdown"]}\n\n</div>'
    if "text/html" in data:
        return f'<div class="output">{_bare(data["text/html"])}</div>'
    return _text(data.get("text/plain", ""))  # progress is gone by now: an empty text


def _bare(table: str) -> str:
    """A table of pandas without the frame and the styles that it brings."""
    return re.sub(r'<style.*?</style>| border="1"| style="[^"]*"', "", table, flags=re.DOTALL)


def _text(text: str) -> str:
    return f'<div class="output"><pre>{html.escape(text.rstrip())}</pre></div>' if text else ""


def _figure(figure: Any, ident: str) -> str:
    """A Plotly figure, drawn by the page's own copy of Plotly when it comes into sight."""
    layout = {k: v for k, v in figure["layout"].items() if k != "width"}
    height = layout.get("height", 450)
    text = json.dumps({"data": figure["data"], "layout": layout}).replace("</", "<\\/")
    return (
        f'<div class="output figure" id="{ident}" style="height:{height}px"></div>'
        f'<script type="application/json" data-figure="{ident}">{text}</script>'
    )
