"""Run the notebooks of the documentation, and write them with their results.

Websites that host code show the results, but do not run notebooks. The script needs the libraries of `make docs`.
"""

import re
import tempfile
from pathlib import Path

from drake_quad.command_line.running import run

from drake_quad.command_line.options import parser_without_options
from drake_quad.command_line.output import print_files
from drake_quad.files import output_folder, write_text

_DOCS = Path(__file__).parents[2] / "docs"
_TIMEOUT = 300  # s, largest run time of a cell


def main() -> None:
    """Run all notebooks of the documentation, and write the results."""
    options = parser_without_options(__doc__, "python scripts/development/run_notebooks.py --output docs/notebooks")
    options.add_argument("--output", type=Path, default=Path("out/notebooks"), help="folder (default: %(default)s)")
    folder = output_folder(options.parse_args().output)
    pages = [page for page in sorted(_DOCS.rglob("*.md")) if "{code-cell}" in page.read_text(encoding="utf-8")]
    print_files([write_text(folder / f"{page.stem}.ipynb", with_results(page)) for page in pages])


def with_results(page: Path) -> str:
    """Run the code of a page in MyST Markdown, and return a Jupyter notebook with its results as JSON text.

    Relative links are rewritten, because the notebook is in a sibling folder of the page.
    """
    # Imported here, because the help text of this script does not need these libraries.
    import nbformat
    from myst_nb.core.read import read_myst_markdown_notebook
    from nbclient import NotebookClient

    text = re.sub(r"\]\((?!\.\.|http|#)([^)]+)\)", rf"](../{page.parent.name}/\1)", page.read_text(encoding="utf-8"))
    notebook = read_myst_markdown_notebook(text, path=page)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=_TIMEOUT, resources={"metadata": {"path": folder}}).execute()
    for number, cell in enumerate(notebook.cells):
        # Identifiers and metadata change in each run. They are replaced, so that equal results give equal files.
        cell["id"] = f"cell-{number}"
        cell["metadata"] = {}
        for output in cell.get("outputs", []):
            output.get("metadata", {}).clear()
    notebook.metadata = {"kernelspec": notebook.metadata["kernelspec"]}
    return str(nbformat.writes(notebook)) + "\n"


if __name__ == "__main__":
    run(main)
