"""Write reference pages of the scenario language, the commands and formulas, and a JSON schema for editors."""

import json
from pathlib import Path

from drake_quad.command_line.running import run

from drake_quad.command_line.documentation import command_page, formula_page
from drake_quad.command_line.options import parser_without_options
from drake_quad.command_line.output import print_files
from drake_quad.files import output_folder, write_text
from drake_quad.scenario.schema import file_schema, language_page

# Pages of which only some parts are generated, and the functions that update these parts.
_UPDATED_PAGES = {"command_line.md": command_page, "formulas.md": formula_page}
_FOLDER = Path(__file__).parents[2] / "docs" / "reference"


def main() -> None:
    options = parser_without_options(
        __doc__, "python scripts/development/document_scenarios.py --output docs/reference"
    )
    options.add_argument("--output", type=Path, default=Path("out/docs"), help="folder (default: %(default)s)")
    folder = output_folder(options.parse_args().output)
    schema = json.dumps(file_schema(), indent=1, ensure_ascii=False) + "\n"
    pages = {name: update((_FOLDER / name).read_text(encoding="utf-8")) for name, update in _UPDATED_PAGES.items()}
    texts = {"scenario_language.md": language_page(), "scenario.schema.json": schema, **pages}
    print_files([write_text(folder / name, text) for name, text in texts.items()])


if __name__ == "__main__":
    run(main)
