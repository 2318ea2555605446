"""Record outputs of the PID controller in the Crazyflie firmware, with which tests/design/test_firmware.py compares.

The argument is a checkout of github.com/bitcraze/crazyflie-firmware (GPL-3.0, version 2025.12.1). The script compiles
the unchanged C files of the firmware, and stores only the numbers that they compute.
"""

import ctypes
import subprocess
import tempfile
from pathlib import Path

from drake_quad.command_line.running import run

import numpy as np

from drake_quad.command_line.options import parser_without_options

HARNESS = Path(__file__).with_name("crazyflie_firmware.c")
TEST_FOLDER = Path(__file__).parents[2] / "tests" / "design"
FLOAT_POINTER = ctypes.POINTER(ctypes.c_float)
INPUT_NAMES = "x y z v_x v_y v_z roll pitch yaw gyro_x gyro_y gyro_z x_r y_r z_r yaw_r"
OUTPUT_NAMES = "roll_d pitch_d yaw_d thrust roll_rate_d pitch_rate_d yaw_rate_d roll_out pitch_out yaw_out m1 m2 m3 m4"
INCLUDE_FOLDERS = (
    "modules/src modules/src/controller modules/interface modules/interface/controller utils/interface"
    " utils/interface/lighthouse hal/interface drivers/interface"
)
# Replacements for headers that depend on hardware or libraries. They contain only the parts that the controller uses.
STUB_HEADERS = {
    "autoconf.h": "#define CONFIG_PLATFORM_CF2\n#define CONFIG_ENABLE_THRUST_BAT_COMPENSATED\n"
    "#define CONFIG_CRAZYFLIE_21_PLUS",
    "log.h": "\n".join(f"#define LOG_{name}(...)" for name in ("GROUP_START", "ADD", "ADD_CORE", "GROUP_STOP")),
    "param.h": "\n".join(f"#define PARAM_{name}(...)" for name in ("GROUP_START", "ADD", "ADD_CORE", "GROUP_STOP")),
    "math3d.h": "#include <math.h>\nstruct vec { float x, y, z; };\nstruct quat { float x, y, z, w; };\n"
    "static inline struct quat mkquat(float x, float y, float z, float w) { return (struct quat){x, y, z, w}; }\n"
    "static inline struct vec quat2rpy(struct quat q) { return (struct vec){q.x, q.y, q.z}; }\n"
    "static inline float radians(float a) { return a * 0.01745329252f; }\n"
    "static inline float degrees(float a) { return a * 57.29577951f; }",
    "debug.h": "#define DEBUG_PRINT(...)",
    "config.h": "",
}
# Final amplitudes of the inputs. The amplitudes grow over time: no limit is active at first, and all are at the end.
FINAL_AMPLITUDES = [0.4, 0.4, 0.3, 0.6, 0.6, 0.4, 14.0, 11.0, 120.0, 90.0, 80.0, 50.0, 0.9, 0.8, 0.4, 100.0]


def inputs(count: int) -> np.ndarray:
    """Return test inputs (count, 16) in single precision, which are sums of sines sampled at 500 Hz."""
    rng, time = np.random.default_rng(2025), 0.002 * np.arange(count)
    waves = [
        amplitude * sum(np.sin(w * time + phase) for w, phase in rng.uniform([1.0, 0.0], [25.0, 6.28], (3, 2)))
        for amplitude in FINAL_AMPLITUDES
    ]
    rows = np.array(waves).T * np.linspace(0.0, 1.2, count)[:, None] ** 2
    rows[:, [8, 15]] = (rows[:, [8, 15]] + 180.0) % 360.0 - 180.0
    return np.ascontiguousarray(rows, dtype=np.float32)


def compiled(source: Path, folder: Path) -> Path:
    """Compile the firmware's controller to a shared library in a folder, and return its path.

    Args:
        source: folder `src` of the firmware.
        folder: folder for the library.
    """
    for name, text in STUB_HEADERS.items():
        (folder / name).write_text(text)
    include_folders = [folder, *(source / each for each in INCLUDE_FOLDERS.split()), source / "platform" / "interface"]
    files = [HARNESS, *(source / "utils" / "src" / name for name in ("pid.c", "num.c", "filter.c"))]
    library = folder / "firmware.so"
    search = [f"-I{each}" for each in include_folders]
    subprocess.run(["cc", "-O1", "-w", "-shared", "-fPIC", *search, "-o", library, *files, "-lm"], check=True)
    return library


def outputs(library: Path, given: np.ndarray, tuned: np.ndarray | None) -> np.ndarray:
    """Return the outputs (count, 14) of the firmware for given inputs.

    Args:
        library: path of the compiled controller.
        given: inputs (count, 16).
        tuned: parameters of the controller, or None for the default parameters of the firmware.
    """
    # Each call loads a separate copy of the library, so that static variables start with their initial values.
    copy = library.with_name(f"firmware_{tuned is not None}.so")
    copy.write_bytes(library.read_bytes())
    firmware, out = ctypes.CDLL(str(copy)), np.zeros((len(given), len(OUTPUT_NAMES.split())), dtype=np.float32)
    if tuned is not None:
        firmware.tune(tuned.ctypes.data_as(FLOAT_POINTER))
    firmware.run(len(given), given.ctypes.data_as(FLOAT_POINTER), out.ctypes.data_as(FLOAT_POINTER))
    return out


def main() -> None:
    """Compile and run the controller of the firmware, and record its inputs and outputs."""
    options = parser_without_options(
        __doc__, "python scripts/development/record_crazyflie_firmware.py crazyflie-firmware"
    )
    options.add_argument("checkout", type=Path)
    options.add_argument("--count", type=int, default=160, help="number of ticks at 500 Hz")
    arguments = options.parse_args()
    given = inputs(arguments.count)
    tuned = np.loadtxt(TEST_FOLDER / "crazyflie_tuned.txt", usecols=1, dtype=np.float32)
    with tempfile.TemporaryDirectory() as folder:
        library = compiled(arguments.checkout / "src", Path(folder))
        recorded = [given, outputs(library, given, None), outputs(library, given, tuned)]
    names = [*INPUT_NAMES.split(), *OUTPUT_NAMES.split(), *(f"{name}_tuned" for name in OUTPUT_NAMES.split())]
    path = TEST_FOLDER / "crazyflie_firmware.csv"
    np.savetxt(path, np.hstack(recorded), fmt="%.9g", delimiter=",", header=",".join(names), comments="")


if __name__ == "__main__":
    run(main)
