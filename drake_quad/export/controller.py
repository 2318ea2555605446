"""Export of the controller of a scenario as C code."""

import dataclasses
import hashlib
import io
import json
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_quad.assembly.control import build_control, control_recipes
from drake_quad.assembly.laboratory import laboratory_recipes
from drake_quad.errors import InputError, join_names
from drake_quad.export.diagram_code import HEADER_END, diagram_code
from drake_quad.export.projects.project import ExportedCode
from drake_quad.export.projects.registered import project_files
from drake_quad.export.reference_code import reference_code
from drake_quad.exported.description import DESCRIPTION_FILE, ExportDescription
from drake_quad.files import output_folder, write_text
from drake_quad.flight.mission import plan_route
from drake_quad.framework.c_code import PRECISIONS, identifier, wrapped
from drake_quad.framework.wiring import build, split_output
from drake_quad.planning.duration import flight_duration
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in

# Output ports with rotor commands. Each kind of control allocation has one of them.
_ROTOR_COMMANDS = ("rotor_speed_command", "throttle_command")
_DIGEST_LABEL = "SHA-256 of the scenario:"  # text in the opening comment of every exported C file


class Export(NamedTuple):
    """Result of an export.

    Attributes:
        files: files that were written.
        description: description of the exported code.
    """

    files: list[Path]
    description: ExportDescription


def export_controller(
    scenario: Scenario,
    output: Path | str,
    *,
    name: str = "controller",
    precision: str = "double",
    mixer: bool = False,
    reference: bool = False,
    project: str | None = None,
) -> Export:
    """Write the controller of a scenario as C99, and return what was written.

    The code computes the command to the vehicle, `wrench` or `attitude_target`, from the inputs `measurement` and
    `reference`. It uses no library except `math.h`, allocates no memory and has no global variables.

    The output folder contains the header NAME.h, the source NAME.c and the scenario as YAML. It also contains the
    description `export.json`, which `--controller FOLDER` reads to fly the code.

    Args:
        scenario: scenario with the controller. Other parts may contain distributions.
        output: folder for the files.
        name: name of the files, and prefix of all names in C.
        precision: "double" or "single". In double precision, every command is bitwise equal to the command in a
            simulation.
        mixer: True to compute also the rotor commands from the wrench.
        reference: True to add a function that evaluates the planned reference.
        project: name of a project to write around the code, in a folder of this name; a key of
            `drake_quad.export.projects.registered.PROJECTS`.

    Raises:
        InputError: if the controller contains distributions or systems without formulas, the name is not a C
            identifier, or the folder contains a C file of this name that was not exported.
    """
    if precision not in PRECISIONS:
        raise InputError(f"precision is {precision!r}; it must be one of {join_names([*PRECISIONS])}")
    if identifier(name) != name:
        raise InputError(f"name is {name!r}; it must be a C identifier, such as controller")
    for path in distributions_in(scenario):
        if path.startswith("control."):
            raise InputError(f"{path} is a distribution, but exported code needs a fixed value; set {path} to a number")
    plan = plan_route(scenario)
    diagram, outputs = _diagram(scenario, plan, mixer=mixer)
    period = scenario.laboratory.command_link.period
    code = diagram_code(diagram, name=name, outputs=outputs, output_period=period, precision=PRECISIONS[precision])
    if reference:
        declaration, definition = reference_code(
            plan, name=name, inputs=[*code.interface.inputs], precision=PRECISIONS[precision]
        )
        code = code._replace(
            header=f"{code.header.removesuffix(HEADER_END)}{declaration}\n{HEADER_END}",
            source=f"{code.source}\n{definition}",
        )
    stream = io.StringIO()
    save_scenario(scenario, stream)
    description = ExportDescription(
        name=name,
        precision=precision,
        scenario=scenario.name,
        scenario_sha256=hashlib.sha256(stream.getvalue().encode()).hexdigest(),
        version=version("drake_quad"),
        **dataclasses.asdict(code.interface),
    )
    header, source = (f"{_opening(description)}\n{text}" for text in (code.header, code.source))
    project_texts = {}
    if project is not None:
        exported = ExportedCode(description, header, source, code.structs, nominal_parameters(scenario), reference)
        project_texts = project_files(project, exported)
    folder = output_folder(Path(output))
    for suffix in (".h", ".c"):
        _check_replaceable(folder / f"{name}{suffix}")
    files = [
        write_text(folder / f"{name}.h", header),
        write_text(folder / f"{name}.c", source),
        write_text(folder / DESCRIPTION_FILE, json.dumps(dataclasses.asdict(description), indent=2) + "\n"),
        write_text(folder / "scenario.yaml", stream.getvalue()),
    ]
    for path, text in project_texts.items():
        file = folder / str(project) / path
        output_folder(file.parent)
        files.append(write_text(file, text))
    return Export(files, description)


def _check_replaceable(file: Path) -> None:
    """Check that a file does not exist, or that it was written by an export.

    Raises:
        InputError: if the file exists and was not written by an export.
    """
    if file.is_file() and _DIGEST_LABEL not in file.read_text(encoding="utf-8", errors="replace").partition("*/")[0]:
        raise InputError(f"{file} was not exported by drake_quad; choose another name or folder, or delete it")


def _diagram(scenario: Scenario, plan: Plan, *, mixer: bool) -> tuple[Diagram, list[str]]:
    """Return the diagram to export, and the names of its outputs.

    Raises:
        InputError: if a mixer is requested, but an autopilot on board computes the rotor commands.
    """
    batch = Batch.draw(scenario, [scenario.sample or 0])
    control = build_control(batch.scenario, control_recipes(batch, plan), 1)
    command = scenario.laboratory.autopilot.command
    if not mixer:
        return control, [command]
    if command != "wrench":
        raise InputError(
            f"mixer: the controller of {scenario.name} commands an attitude to the autopilot, which computes the rotor"
            " commands on board; export the controller without a mixer"
        )
    builder = DiagramBuilder()
    builder.AddNamedSystem("control", control)
    recipe = laboratory_recipes(batch, plan, flight_duration(batch.scenario, plan))["allocation"]
    allocation = recipe.build(1)
    parts = split_output(builder, "allocation", allocation)
    builder.Connect(control.GetOutputPort(command), allocation.GetInputPort(command))
    for index in range(control.num_input_ports()):
        port = control.get_input_port(index)
        builder.ExportInput(port, port.get_name())
    builder.ExportOutput(control.GetOutputPort(command), command)
    rotors = next(port for port in _ROTOR_COMMANDS if port in parts)
    builder.ExportOutput(parts[rotors], rotors)
    return build(builder, "controller"), [command, rotors]


def _opening(description: ExportDescription) -> str:
    """Return the comment at the beginning of the header and of the source file."""
    number = PRECISIONS[description.precision].num_bytes
    lines = [
        f"Controller of the scenario {description.scenario}, exported by drake_quad {description.version}.",
        f"{_DIGEST_LABEL} {description.scenario_sha256}",
        "",
        f"Call {description.name}_init once, then {description.name}_step every {description.period:g} s.",
        f"A step takes at most {description.num_operations} arithmetic operations and calls of math.h. The state takes"
        f" {number * description.num_states + 4} bytes, the parameters {number * description.num_parameters} bytes.",
        "",
        "Compile as C99 without -ffast-math and with -ffp-contract=off. In double precision, each result is then",
        "bitwise equal to the result in simulation.",
        "",
        "This code may be used under the BSD 3-Clause License of drake_quad.",
    ]
    return "\n".join(["/*", *(f" * {each}".rstrip() for line in lines for each in wrapped(line)), " */", ""])
