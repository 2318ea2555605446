"""Sphinx configuration of the documentation, which `make docs` builds."""

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
# Notebooks are executed whenever the site is built. An error in a notebook stops the build.
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
smartquotes_action = "qe"  # quotes and ellipses only: a dash would replace the two hyphens of a command's option
html_show_sphinx = False
default_role = "code"
autodoc_member_order = "bysource"
autodoc_mock_imports = ["stable_baselines3"]  # not imported, because it depends on PyTorch
autodoc_default_options = {"members": True}
autodoc_use_type_comments = False  # the package has no type comments, and searching for them is slow
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Attributes", "params_style")]


class PortBlock(Directive):
    """Directive `pydrake_system`, which shows the ports of a system in the format of Drake's documentation."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Return the content of the directive as a block of YAML code."""
        text = "\n".join(self.content)
        return [nodes.literal_block(text, text, language="yaml")]


def keep_formulas(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Edit a docstring for Sphinx.

    Formulas (indented blocks) and vertical bars are marked as literal text. The docstring of a record is extended by
    the units of its fields.
    """
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
        # The backslash prevents Sphinx from interpreting a letter with a full stop as an item of a list.
        text = re.sub(r": (\w)\.$", r": \1\\.", line.replace("|", r"\|"))
        result.append(line if inside or directive else text)
    lines[:] = [*result, *units_of_rows(obj)]


def units_of_rows(record: Any) -> list[str]:
    """Return a line of text with the unit and the frame of each field of a record; other objects have no lines."""
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


def short_signature(app: Any, what: str, name: str, obj: Any, options: Any, signature: str, returns: str) -> Any:
    """Return the signature of a record without types, or that of a system with the arguments of its `declare`."""
    if what == "class" and hasattr(obj, "_fields"):
        defaults = {name: f"={value!r}" for name, value in obj._field_defaults.items() if not isinstance(value, tuple)}
        return f"({', '.join(field + defaults.get(field, '') for field in obj._fields)})", ""
    if what != "class" or not hasattr(obj, "declare") or name.endswith(".FleetSystem"):
        return None
    _, *arguments = inspect.signature(obj.declare).parameters.values()
    return f"({', '.join(['*', 'num_vehicles=1', *(str(each) for each in arguments)])})", ""


def is_skipped(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Return True for members that the reference leaves out.

    These are the fields of records, which the docstring of the record describes, and objects of other packages.
    """
    if type(obj).__name__ == "_tuplegetter" or "[" in name or name in ("model_config", "ToAutoDiffXd", "ToSymbolic"):
        return True
    return True if str(getattr(obj, "__module__", "")).startswith(("pydrake", "matplotlib")) else None


def write_reference(app: Any) -> None:
    """Write a reference page for each folder of the package with all of its modules, and an index of public names."""
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
    """Stop Sphinx from building pages from `docs/notebooks/*.ipynb`, which remain available as downloads.

    The same pages are built from their Markdown files.
    """
    del config.source_suffix[".ipynb"]


class IndexedPythonDomain(PythonDomain):
    """Python domain that finds the target of a reference in an index instead of searching all objects."""

    @functools.cached_property
    def _objects_by_last_part(self) -> dict[str, dict[str, Any]]:
        index: dict[str, dict[str, Any]] = defaultdict(dict)
        for name, entry in self.objects.items():
            index[name.rpartition(".")[2]][name] = entry
        return index

    def find_obj(self, env: Any, modname: str, classname: str, name: str, *options: Any, **named: Any) -> Any:
        """Return the objects that a dotted name may refer to, searching only those with the same last component."""
        candidates = self._objects_by_last_part.get(name.removesuffix("()").rpartition(".")[2], {})
        domain = copy.copy(self)
        domain.data = {**self.data, "objects": candidates}
        return PythonDomain.find_obj(domain, env, modname, classname, name, *options, **named)


@functools.cache
def _titles(environment: Any) -> dict[str, Any]:
    """Return the table of contents of each page, reduced to the title and the toctrees of the page."""
    tables = {page: toc.deepcopy() for page, toc in environment.tocs.items()}
    for item in itertools.chain.from_iterable(table.children for table in tables.values()):
        if len(item) > 1:
            toctrees = list(item.findall(addnodes.toctree))
            item[1:] = [nodes.bullet_list("", *toctrees)] if toctrees else []
    return tables


def navigate_by_titles(app: Any, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Build the navigation from page titles only.

    Otherwise Sphinx would copy the entries of all documented objects for each page, only to omit them afterwards.
    """
    toctree = context["toctree"]

    def toctree_of_titles(**options: Any) -> str:
        complete, app.env.tocs = app.env.tocs, _titles(app.env)
        try:
            return toctree(**options)
        finally:
            app.env.tocs = complete

    context["toctree"] = toctree_of_titles


def setup(app: Any) -> None:
    """Register the directive, the domain and the event handlers of this file with Sphinx."""
    app.connect("config-inited", keep_notebooks_as_files, priority=900)  # after MyST-NB has registered the suffix
    # autosummary reads the pages at the same event, with the priority 500.
    app.connect("builder-inited", write_reference, priority=100)
    app.connect("html-page-context", navigate_by_titles, priority=400)  # before the theme
    app.add_domain(IndexedPythonDomain, override=True)
    app.add_directive("pydrake_system", PortBlock)
    app.connect("autodoc-process-docstring", keep_formulas, priority=400)
    app.connect("autodoc-process-signature", short_signature)
    app.connect("autodoc-skip-member", is_skipped)
