"""Generator of LLVM code for loops and branches, which call the functions that `instructions` generates.

    driver = Driver("internal void @double(ptr %numbers, i64 %n)")
    with driver.loop("k", 0, "%n"):
        driver.let("at", "getelementptr double, ptr %numbers, i64 %k")
        driver.let("number", "load double, ptr %at, align 8")
        driver.let("twice", "fadd double %number, %number")
        driver.do("store double %twice, ptr %at, align 8")
    text = driver.text()

Names of values are written with a leading `%` in instructions, and without it as the first argument of `let` and `at`.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from drake_quad.framework.machine_code import ELEMENTS_POINTER_OFFSET


class Driver:
    """LLVM function that returns nothing, and to which instructions are appended in order.

    Names of values and counters must be unique within the function.

    Args:
        head: linkage, name, arguments and attributes of the function.
    """

    def __init__(self, head: str) -> None:
        self._lines = [f"define {head} {{", "entry:"]
        self._label = "entry"

    @classmethod
    def of_arrays(cls, numbers: str, arrays: Sequence[str]) -> "Driver":
        """Return a driver for the function `kernel`, which Python calls with numbers and NumPy arrays.

        Args:
            numbers: LLVM declaration of the arguments that are numbers, such as `i64 %n`; they come first.
            arrays: names of the remaining arguments, which are arrays. Each name refers to the pointer to the array's
                elements.
        """
        driver = cls(f"void @kernel({numbers}, {', '.join(f'ptr %{name}_array' for name in arrays)})")
        for name in arrays:
            driver.let(f"{name}_at", f"getelementptr i8, ptr %{name}_array, i64 {ELEMENTS_POINTER_OFFSET}")
            driver.let(name, f"load ptr, ptr %{name}_at")
        return driver

    def let(self, name: str, instruction: str) -> None:
        """Append an instruction, and assign a name to its result."""
        self.do(f"%{name} = {instruction}")

    def at(self, name: str, pointer: str, index: str | int, kind: str = "double") -> None:
        """Append an instruction that computes the pointer to an array element.

        Args:
            name: name of the result.
            pointer: name of the pointer to the array's first element.
            index: index of the element.
            kind: LLVM type of the elements.
        """
        self.let(name, f"getelementptr {kind}, ptr %{pointer}, i64 {index}")

    def do(self, instruction: str) -> None:
        """Append an instruction whose result, if any, is not named."""
        self._lines.append(f"  {instruction}")

    @contextmanager
    def loop(self, counter: str, begin: str | int, end: str | int, step: int = 1) -> Iterator[None]:
        """Append a loop that runs while a counter is less than `end`; the `with` statement appends the body."""
        previous_label = self._label
        self.let(f"{counter}_nonempty", f"icmp ult i64 {begin}, {end}")
        self.do(f"br i1 %{counter}_nonempty, label %{counter}_body, label %{counter}_end")
        self._block(f"{counter}_body")
        phi_index = len(self._lines)
        yield
        # The phi instruction needs the label of the block that jumps back, which is known only after the body is
        # appended.
        phi = f"  %{counter} = phi i64 [{begin}, %{previous_label}], [%{counter}_next, %{self._label}]"
        self._lines.insert(phi_index, phi)
        self.let(f"{counter}_next", f"add i64 %{counter}, {step}")
        self.let(f"{counter}_again", f"icmp ult i64 %{counter}_next, {end}")
        self.do(f"br i1 %{counter}_again, label %{counter}_body, label %{counter}_end")
        self._block(f"{counter}_end")

    @contextmanager
    def when(self, name: str, condition: str) -> Iterator[None]:
        """Append a branch that is executed if a condition is true; the `with` statement appends the body.

        Args:
            name: name of the condition's result, and prefix of the labels.
            condition: instruction that computes the condition.
        """
        self.let(name, condition)
        self.do(f"br i1 %{name}, label %{name}_then, label %{name}_end")
        self._block(f"{name}_then")
        yield
        self.do(f"br label %{name}_end")
        self._block(f"{name}_end")

    def text(self) -> str:
        """Return the LLVM code of the driver function."""
        return "\n".join([*self._lines, "  ret void", "}"])

    def _block(self, label: str) -> None:
        self._lines.append(f"{label}:")
        self._label = label


def copy_functions(lanes: int) -> str:
    """Return the LLVM code of the functions `gather` and `scatter`.

    `gather` copies the rows of up to `lanes` vehicles from a fleet to vectors, and `scatter` copies them back. Lanes
    without a vehicle are filled with copies of the last vehicle.
    """
    gather = _copy_function("gather", lanes, lanes, "fleet", "copy")
    return "\n".join([gather, _copy_function("scatter", lanes, "%left", "copy", "fleet")])


def _copy_function(name: str, lanes: int, count: str | int, source: str, target: str) -> str:
    """Return the LLVM code of a function that copies rows, each as a whole vector or element by element."""
    vector = f"<{lanes} x i64>"
    arguments = "ptr %copy, ptr %fleet, i64 %rows, i64 %stride, i64 %left"
    driver = Driver(f"internal void @{name}({arguments}) noinline")
    driver.let("last", "sub i64 %left, 1")
    driver.let("full", f"icmp uge i64 %left, {lanes}")
    driver.let("first", f"select i1 %full, i64 {count}, i64 0")
    with driver.loop("row", 0, "%rows"):
        driver.let("to", f"mul i64 %row, {lanes}")
        driver.let("from", "mul i64 %row, %stride")
        driver.at("copy_row", "copy", "%to")
        driver.at("fleet_row", "fleet", "%from")
        with driver.when("whole", f"icmp uge i64 %left, {lanes}"):
            driver.let("all", f"load {vector}, ptr %{source}_row, align 8")
            driver.do(f"store {vector} %all, ptr %{target}_row, align 8")
        with driver.loop("lane", "%first", count):
            driver.let("within", "icmp ult i64 %lane, %last")
            driver.let("vehicle", "select i1 %within, i64 %lane, i64 %last")
            driver.at("copy_at", "copy_row", "%lane")
            driver.at("fleet_at", "fleet_row", "%vehicle")
            driver.let("one", f"load i64, ptr %{source}_at, align 8")
            driver.do(f"store i64 %one, ptr %{target}_at, align 8")
    return driver.text()
