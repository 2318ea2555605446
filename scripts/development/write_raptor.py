"""Write the weights of RAPTOR, a policy for quadrotors of all sizes, from its published package to an .npz file.

J. Eschmann, D. Albani and G. Loianno, "RAPTOR: a foundation policy for quadrotor control", 2025 (arXiv 2509.11481); the
package foundation-policy 1.0.2 contains the network under the MIT licence: pip install foundation-policy==1.0.2

The network expects position and velocity minus the reference, whereas errors in this library have the opposite sign.
The file therefore scales these inputs by -1.
"""

from pathlib import Path
from typing import Any

from drake_quad.command_line.running import run

import numpy as np

from drake_quad.command_line.options import parser_without_options
from drake_quad.command_line.output import print_files
from drake_quad.extras import import_extra
from drake_quad.files import output_folder, write_atomically

# Factor of each input: position error (3), rotation (9), velocity error (3), body rates (3) and last action (4).
_SCALE = np.repeat([-1.0, 1.0, -1.0, 1.0, 1.0], [3, 9, 3, 3, 4])


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/write_raptor.py --output diagrams/policies")
    options.add_argument("--output", default="out/policies", help="folder for the file (default: out/policies)")
    folder = output_folder(Path(options.parse_args().output))
    arrays = network_of(import_extra("foundation_policy", "test").Raptor())
    print_files([write_atomically(folder / "raptor.npz", lambda path: np.savez(path, **arrays))])


def network_of(raptor: Any) -> dict[str, Any]:
    """Return the arrays of a policy file of this library that describe a network from the package foundation-policy."""
    first, memory, last = raptor.layers
    return {
        "scale": _SCALE,
        "weights_0": first.weights,
        "biases_0": first.biases.ravel(),
        "activation_0": np.array(first.activation_function_name.lower()),
        "weights_input_1": memory.weights_input,
        "biases_input_1": memory.biases_input,
        "weights_hidden_1": memory.weights_hidden,
        "biases_hidden_1": memory.biases_hidden,
        "initial_1": memory.initial_hidden_state,
        "weights_2": last.weights,
        "biases_2": last.biases.ravel(),
    }


if __name__ == "__main__":
    run(main)
