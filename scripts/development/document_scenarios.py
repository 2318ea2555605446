"""Document the scenario language and the commands: pages for readers, and a JSON schema for editors."""

import json
from pathlib import Path

from drake_quad.command_line.running import run

from drake_quad.command_line.documentation import command_page
from drake_quad.command_line.options import bare_parser
from drake_quad.command_line.output import print_files
from drake_quad.files import output_folder, write_text
from drake_quad.scenario.schema import file_schema, language_page

_COMMAND_PAGE = Path(__file__).parents[2] / "docs" / "reference" / "command_line.md"


def main() -> None:
    options = bare_parser(__doc__, "python scripts/development/document_scenarios.py --output docs/reference")
    options.add_argument("--output", type=Path, default=Path("out/docs"), help="folder (default: %(default)s)")
    folder = output_folder(options.parse_args().output)
    schema = json.dumps(file_schema(), indent=1, ensure_ascii=False) + "\n"
    commands = command_page(_COMMAND_PAGE.read_text(encoding="utf-8"))
    texts = {"scenario_language.md": language_page(), "scenario.schema.json": schema, _COMMAND_PAGE.name: commands}
    print_files([write_text(folder / name, text) for name, text in texts.items()])


if __name__ == "__main__":
    run(main)
