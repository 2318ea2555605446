"""LLVM code of counted loops that call the functions that `instructions` writes from listings.

    driver = Driver("internal void @double(ptr %numbers, i64 %n)")
    with driver.loop("k", 0, "%n"):
        driver.let("at", "getelementptr double, ptr %numbers, i64 %k")
        driver.let("number", "load double, ptr %at, align 8")
        driver.let("twice", "fadd double %number, %number")
        driver.do("store double %twice, ptr %at, align 8")
    text = driver.text()

Names of values are written with `%` where they are used, and without where they are given.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from drake_quad.framework.machine_code import POINTER


class Driver:
    """A function without a result, written from its first instruction to its last.

    Names of values and counters are unique within the function.

    Args:
        head: linkage, name, arguments and attributes.
    """

    def __init__(self, head: str) -> None:
        self._lines = [f"define {head} {{", "entry:"]
        self._label = "entry"

    @classmethod
    def of_arrays(cls, numbers: str, arrays: Sequence[str]) -> "Driver":
        """Return the function `kernel`, which Python calls, with pointers to the elements of arrays.

        Args:
            numbers: its first arguments, as in `i64 %n`.
            arrays: names of the pointers; the further arguments are arrays of NumPy, in this order.
        """
        driver = cls(f"void @kernel({numbers}, {', '.join(f'ptr %{name}_array' for name in arrays)})")
        for name in arrays:
            driver.let(f"{name}_at", f"getelementptr i8, ptr %{name}_array, i64 {POINTER}")
            driver.let(name, f"load ptr, ptr %{name}_at")
        return driver

    def let(self, name: str, instruction: str) -> None:
        """Write an instruction that gives a value its name."""
        self.do(f"%{name} = {instruction}")

    def at(self, name: str, pointer: str, place: str | int, kind: str = "double") -> None:
        """Write the pointer to an element, given the name of the pointer to the first one, the index and the type."""
        self.let(name, f"getelementptr {kind}, ptr %{pointer}, i64 {place}")

    def do(self, instruction: str) -> None:
        """Write an instruction."""
        self._lines.append(f"  {instruction}")

    @contextmanager
    def loop(self, counter: str, begin: str | int, end: str | int, step: int = 1) -> Iterator[None]:
        """Write a loop whose body is written inside the `with` statement, and runs while a counter is below its end."""
        before = self._label
        self.let(f"{counter}_some", f"icmp ult i64 {begin}, {end}")
        self.do(f"br i1 %{counter}_some, label %{counter}_body, label %{counter}_end")
        self._block(f"{counter}_body")
        place = len(self._lines)
        yield
        # The label of the block that jumps back is known only now.
        phi = f"  %{counter} = phi i64 [{begin}, %{before}], [%{counter}_next, %{self._label}]"
        self._lines.insert(place, phi)
        self.let(f"{counter}_next", f"add i64 %{counter}, {step}")
        self.let(f"{counter}_more", f"icmp ult i64 %{counter}_next, {end}")
        self.do(f"br i1 %{counter}_more, label %{counter}_body, label %{counter}_end")
        self._block(f"{counter}_end")

    @contextmanager
    def when(self, name: str, condition: str) -> Iterator[None]:
        """Write a branch whose body is written inside the `with` statement, and runs if a named condition holds."""
        self.let(name, condition)
        self.do(f"br i1 %{name}, label %{name}_so, label %{name}_end")
        self._block(f"{name}_so")
        yield
        self.do(f"br label %{name}_end")
        self._block(f"{name}_end")

    def text(self) -> str:
        """Return the whole function."""
        return "\n".join([*self._lines, "  ret void", "}"])

    def _block(self, label: str) -> None:
        self._lines.append(f"{label}:")
        self._label = label


def copying(lanes: int) -> str:
    """Return `gather`, which copies rows of at most one vector of vehicles out of a fleet, and `scatter`, the reverse.

    Lanes without a vehicle get the numbers of the last vehicle.
    """
    both = _copying("gather", lanes, lanes, "fleet", "copy"), _copying("scatter", lanes, "%left", "copy", "fleet")
    return "\n".join(both)


def _copying(name: str, lanes: int, count: str | int, source: str, target: str) -> str:
    """Return a function that copies whole vectors, or `count` single elements of every row."""
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
