"""Sphinx: `make docs` builds the pages and the reference."""

import copy
import functools
import inspect
import itertools
import re
from collections import defaultdict
from pathlib import Path
from typing import Any, get_args, get_type_hints

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx import addnodes
from sphinx.domains.python import PythonDomain

from drake_quad.signals import Quantity

project = "drake_quad"
author = "The drake_quad authors"
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
]
myst_enable_extensions = ["attrs_block", "colon_fence", "dollarmath", "html_image"]
myst_heading_anchors = 3
# Notebooks are flown whenever the site is built; one that fails fails the build.
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
copybutton_exclude = ".linenos, .gp, .go"
exclude_patterns = ["replication/table_ii.md"]
html_theme = "furo"
html_title = "drake_quad"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_copyright = False
smartquotes_action = "qe"  # options begin with two dashes
html_show_sphinx = False
default_role = "code"
autodoc_member_order = "bysource"
autodoc_mock_imports = ["stable_baselines3"]  # brings PyTorch with it
autodoc_default_options = {"members": True}
autodoc_use_type_comments = False  # there are none, and reading each function's source again takes long
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Attributes", "params_style")]


class PortBlock(Directive):
    """The ports of a system, as Drake's documentation writes them."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the block as it is written."""
        text = "\n".join(self.content)
        return [nodes.literal_block(text, text, language="yaml")]


def as_written(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Keep formulas, which are the indented blocks of docstrings, and bars in the text as they are written."""
    result: list[str] = []
    inside = False
    for i, line in enumerate(lines):
        indented = line.startswith("    ")
        begins = indented and not inside and i > 0 and not lines[i - 1].strip()
        inside = inside and (indented or not line.strip())
        directive = any(before.startswith("..") for before in result[-3:])
        if begins and not directive:
            result += ["::", ""]
            inside = True
        # A letter before a full stop is no list.
        text = re.sub(r": (\w)\.$", r": \1\\.", line.replace("|", r"\|"))
        result.append(line if inside or directive else text)
    lines[:] = [*result, *rows_of(obj)]


def rows_of(record: Any) -> list[str]:
    """Return the units of the rows of a record as text, and the frames of their axes."""
    if not (isinstance(record, type) and hasattr(record, "_fields")):
        return []
    hints = get_type_hints(record, include_extras=True)
    found = [
        (name, next((part for part in get_args(hints[name]) if isinstance(part, Quantity)), None))
        for name in record._fields
    ]
    texts = []
    for quantity, group in itertools.groupby(found, key=lambda pair: pair[1]):
        if quantity is not None:
            names = ", ".join(f"`{name}`" for name, _ in group)
            texts.append(f"{names} ({quantity.unit}{f' in {quantity.frame}' if quantity.frame else ''})")
    return ["", f"Units: {'; '.join(texts)}.", ""] if texts else []


def constructor(app: Any, what: str, name: str, obj: Any, options: Any, signature: str, returns: str) -> Any:
    """Return the signature of a record without types, or the arguments with which a system is declared."""
    if what == "class" and hasattr(obj, "_fields"):
        defaults = {name: f"={value!r}" for name, value in obj._field_defaults.items() if not isinstance(value, tuple)}
        return f"({', '.join(field + defaults.get(field, '') for field in obj._fields)})", ""
    if what != "class" or not hasattr(obj, "declare") or name.endswith(".FleetSystem"):
        return None
    _, *arguments = inspect.signature(obj.declare).parameters.values()
    return f"({', '.join(['*', 'num_vehicles=1', *(str(each) for each in arguments)])})", ""


def skipped(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Leaves out the fields of records, which the text of the record has, and what is not ours."""
    if type(obj).__name__ == "_tuplegetter" or "[" in name or name in ("model_config", "ToAutoDiffXd", "ToSymbolic"):
        return True
    return True if str(getattr(obj, "__module__", "")).startswith(("pydrake", "matplotlib")) else None


def write_reference(app: Any) -> None:
    """Write a page for each folder of the package, with all of its modules, and an index with the public names."""
    package = Path(__file__).parents[1] / "drake_quad"
    pages = {"modules": [path.stem for path in sorted(package.glob("*.py")) if not path.stem.startswith("_")]}
    for folder in sorted(path.parent for path in package.glob("*/__init__.py")):
        files = sorted(folder.rglob("*.py"), key=lambda path: (path.parent, path.stem != "__init__", path))
        modules = [".".join(path.relative_to(package).with_suffix("").parts) for path in files]
        pages[folder.name] = [module.removesuffix(".__init__") for module in modules]
    texts = {name: f"# {name}\n{''.join(map(_module, modules))}" for name, modules in pages.items()}
    imports = re.findall(r"from \.([\w.]+) import (\w+)", (package / "__init__.pyi").read_text())
    names = "\n".join(sorted(f"   drake_quad.{module}.{name}" for module, name in imports))
    tree = "\n".join(sorted(texts))
    texts["index"] = (
        "# Reference of the package\n\nThese names can be imported from `drake_quad` itself:\n\n"
        f"```{{eval-rst}}\n.. autosummary::\n\n{names}\n```\n\n```{{toctree}}\n:maxdepth: 1\n\n{tree}\n```\n"
    )
    output = Path(app.srcdir) / "reference" / "api"
    output.mkdir(exist_ok=True)
    for page in output.glob("*.md"):
        page.unlink()
    for name, text in texts.items():
        (output / f"{name}.md").write_text(text)


def _module(name: str) -> str:
    return f"\n```{{eval-rst}}\n.. automodule:: drake_quad.{name}\n```\n"


def keep_notebooks_as_files(app: Any, config: Any) -> None:
    """Offer `docs/notebooks/*.ipynb` as downloads, since the site has these pages from their Markdown files."""
    del config.source_suffix[".ipynb"]


class IndexedPythonDomain(PythonDomain):
    """The domain of Python, which looks names up in an index instead of comparing them with every object."""

    @functools.cached_property
    def _objects_by_last_part(self) -> dict[str, dict[str, Any]]:
        index: dict[str, dict[str, Any]] = defaultdict(dict)
        for name, entry in self.objects.items():
            index[name.rpartition(".")[2]][name] = entry
        return index

    def find_obj(self, env: Any, modname: str, classname: str, name: str, *options: Any, **named: Any) -> Any:
        """Return the objects that a name may refer to. Their last part is the last part of the name."""
        candidates = self._objects_by_last_part.get(name.removesuffix("()").rpartition(".")[2], {})
        domain = copy.copy(self)
        domain.data = {**self.data, "objects": candidates}
        return PythonDomain.find_obj(domain, env, modname, classname, name, *options, **named)


@functools.cache
def _titles(environment: Any) -> dict[str, Any]:
    """Return the table of contents of each page with its title and its toctrees, but without sections and objects."""
    tables = {page: toc.deepcopy() for page, toc in environment.tocs.items()}
    for item in itertools.chain.from_iterable(table.children for table in tables.values()):
        if len(item) > 1:
            toctrees = list(item.findall(addnodes.toctree))
            item[1:] = [nodes.bullet_list("", *toctrees)] if toctrees else []
    return tables


def navigate_by_titles(app: Any, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Build the navigation from titles. Sphinx copies the entries of all objects for each page and then omits them."""
    toctree = context["toctree"]

    def toctree_of_titles(**options: Any) -> str:
        complete, app.env.tocs = app.env.tocs, _titles(app.env)
        try:
            return toctree(**options)
        finally:
            app.env.tocs = complete

    context["toctree"] = toctree_of_titles


def setup(app: Any) -> None:
    """Register the extensions of this file with Sphinx."""
    app.connect("config-inited", keep_notebooks_as_files, priority=900)  # after MyST-NB has registered the suffix
    # autosummary reads the pages at the same event, with the priority 500.
    app.connect("builder-inited", write_reference, priority=100)
    app.connect("html-page-context", navigate_by_titles, priority=400)  # before the theme
    app.add_domain(IndexedPythonDomain, override=True)
    app.add_directive("pydrake_system", PortBlock)
    app.connect("autodoc-process-docstring", as_written, priority=400)
    app.connect("autodoc-process-signature", constructor)
    app.connect("autodoc-skip-member", skipped)
