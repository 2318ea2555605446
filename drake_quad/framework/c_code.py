"""Conversion of recorded formulas to C99.

Each line of a `Listing` is one operation of the formula. It becomes a local variable if its value is used several times
or has a name in the formula. Other lines become part of the expression that uses them:

    const double e_x = reference->x - measurement->x;
    result->pd.x = gains->k_p.x * e_x + gains->k_d.x * v_x;

In double precision, every result is bitwise equal to that of the machine code from `drake_quad.framework.instructions`.
This requires that the compiler neither contracts nor reorders operations (`-ffp-contract=off`, without `-ffast-math`).
Elementary functions are the approximations of this package. In single precision, they are the functions of `math.h`.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.framework.symbols import LEAVES, Branch, Function, Listing, Symbol, SymbolKind, SymbolLayer


class Expression(NamedTuple):
    """Text of a C expression.

    Attributes:
        text: text of the expression.
        precedence: precedence of its outermost operator; a larger number binds more tightly.
    """

    text: str
    precedence: int


class _Template(NamedTuple):
    """Template of an expression.

    Attributes:
        text: text with a placeholder for each operand. {f} is the suffix of functions of `math.h`.
        precedence: precedence of the operator.
        min_precedences: for each operand, the smallest precedence at which it needs no parentheses.
    """

    text: str
    precedence: int
    min_precedences: tuple[int, ...]


# Precedences of expressions in C. The operator with the larger precedence binds more tightly.
_ATOM_PRECEDENCE = 16  # precedence of a name, number or call
_UNARY_PRECEDENCE = 15  # precedence of a unary operator
_LOWEST_PRECEDENCE = 0  # precedence below that of every operator, so that an operand never needs parentheses


def _function_call(text: str, operands: int = 1) -> _Template:
    return _Template(text, _ATOM_PRECEDENCE, (_LOWEST_PRECEDENCE,) * operands)


def _left_associative(operator: str, precedence: int) -> _Template:
    return _Template(f"{{0}} {operator} {{1}}", precedence, (precedence, precedence + 1))


def _in_parentheses(operator: str, precedence: int) -> _Template:
    """Return the template of an operator whose compound operands are always put into parentheses."""
    return _Template(f"{{0}} {operator} {{1}}", precedence, (_UNARY_PRECEDENCE, _UNARY_PRECEDENCE))


# C expression for each operation. `drake_quad.framework.instructions` contains the LLVM instructions for the same
# operations.
EXPRESSIONS = {
    "add": _left_associative("+", 12),
    "subtract": _left_associative("-", 12),
    "multiply": _left_associative("*", 13),
    "divide": _left_associative("/", 13),
    "negative": _Template("-{0}", _UNARY_PRECEDENCE, (_ATOM_PRECEDENCE,)),
    "absolute": _function_call("fabs{f}({0})"),
    "square_root": _function_call("sqrt{f}({0})"),
    "nearest": _function_call("rint{f}({0})"),
    "multiply_add": _function_call("multiply_add({0}, {1}, {2})", 3),
    "copy_sign": _function_call("copysign{f}({0}, {1})", 2),
    "less": _left_associative("<", 10),
    "less_equal": _left_associative("<=", 10),
    "greater": _left_associative(">", 10),
    "greater_equal": _left_associative(">=", 10),
    "equal": _left_associative("==", 9),
    "not_equal": _left_associative("!=", 9),
    "select": _Template("{0} ? {1} : {2}", 3, (9, 4, 4)),
    "float_bits": _function_call("float_bits({0})"),
    "number_of": _function_call("number_of({0})"),
    "sign_bit": _Template("{0} >> 63 != 0", 9, (_UNARY_PRECEDENCE,)),
    "word_of_truth": _function_call("(uint64_t)({0})"),
    "truth_of_word": _Template("({0} & 1) != 0", 9, (_UNARY_PRECEDENCE,)),
}
# C expressions for those operations that are written differently for 64-bit words and booleans than for numbers.
_BITWISE = {
    "add": _left_associative("+", 12),
    "multiply": _left_associative("*", 13),
    "bitwise_and": _in_parentheses("&", 8),
    "bitwise_or": _in_parentheses("|", 6),
    "bitwise_xor": _in_parentheses("^", 7),
    "left_shift": _in_parentheses("<<", 11),
    "right_shift": _in_parentheses(">>", 11),
}
# C has no one-bit booleans, so `&` of booleans is written as `&&`.
_LOGICAL = {
    "bitwise_and": _in_parentheses("&&", 5),
    "bitwise_or": _in_parentheses("||", 4),
    "bitwise_xor": _in_parentheses("!=", 9),
}
_TYPES = {SymbolKind.NUMBER: "{real}", SymbolKind.TRUTH: "bool", SymbolKind.WORD: "uint64_t"}
# For each elementary function, the single-precision functions of `math.h` that compute its results, in order.
_SINGLE_PRECISION_FUNCTIONS = {
    "sin_cos": ("sinf", "cosf"),
    "exp": ("expf",),
    "tanh": ("tanhf",),
    "erf": ("erff",),
    "log": ("logf",),
    "log_normal": ("logf",),
    "log1p": ("log1pf",),
    "arctan": ("atanf",),
    "arctan_small": ("atanf",),
    "arctan2": ("atan2f",),
    "arcsin": ("asinf",),
    "arcsin_small": ("asinf",),
}
# C functions that convert between doubles and 64-bit words.
WORD_FUNCTIONS = """\
static uint64_t float_bits(double number)
{
    uint64_t word;
    memcpy(&word, &number, sizeof word);
    return word;
}

static double number_of(uint64_t word)
{
    double number;
    memcpy(&number, &word, sizeof number);
    return number;
}
"""
# Function that multiplies and adds with a single rounding. The function `fma` of the C library newlib rounds twice if
# the processor has no such instruction. The replacement uses the exact product of T. J. Dekker (1971), the exact sum of
# D. E. Knuth, and S. Boldo and G. Melquiond, "Emulation of FMA and correctly rounded sums", IEEE Transactions on
# Computers 57(4), 2008. Numbers beyond 1e290 and results below 1e-307 may be rounded twice.
MULTIPLY_ADD_FUNCTION = """\
#if defined(_NEWLIB_VERSION) && !defined(__FP_FAST_FMA)
/* Return the rounded sum of two numbers, and its error. */
static double exact_sum(double x, double y, double *error)
{
    const double sum = x + y;
    const double part = sum - x;
    *error = (x - (sum - part)) + (y - part);
    return sum;
}

/* Return the upper half of the digits of a number. */
static double upper_half(double x)
{
    const double scaled = 134217729.0 * x;
    return scaled - (scaled - x);
}

static double multiply_add(double x, double y, double z)
{
    const double product = x * y;
    const double size = fabs(product);
    if (!(size < 1e290 && fabs(z) < 1e290 && fabs(x) < 1e290 && fabs(y) < 1e290))
        return product + z;
    if (size < 1e-270) {
        /* The rounding error of a tiny product can underflow, so the operands are scaled by a power of two. */
        if (x == 0.0 || y == 0.0 || fabs(z) > 1e-240)
            return product + z;
        const double scale = 1.3407807929942597e154;
        return multiply_add(fabs(x) < fabs(y) ? x * scale : x, fabs(x) < fabs(y) ? y : y * scale, z * scale) / scale;
    }
    const double x_upper = upper_half(x), y_upper = upper_half(y);
    const double x_lower = x - x_upper, y_lower = y - y_upper;
    const double product_error =
        ((x_upper * y_upper - product) + x_upper * y_lower + x_lower * y_upper) + x_lower * y_lower;
    double lower, sum_error, odd_error;
    const double upper = exact_sum(z, product_error, &lower);
    const double sum = exact_sum(product, upper, &sum_error);
    double odd = exact_sum(lower, sum_error, &odd_error);
    /* The sum of both errors is rounded to a number with an odd last digit, so that no digit is rounded twice. */
    uint64_t word = float_bits(odd);
    if (odd_error != 0.0 && (word & 1) == 0) {
        word += (odd_error > 0.0) == (odd > 0.0) ? 1 : (uint64_t)-1;
        odd = number_of(word);
    }
    return sum + odd;
}
#else
static double multiply_add(double x, double y, double z)
{
    return fma(x, y, z);
}
#endif
"""
# Smallest 64-bit word that is written in hexadecimal notation. Smaller words, such as shift counts, are written in
# decimal notation.
_MIN_HEXADECIMAL_WORD = 64
# Largest length of an expression that is written inside another expression, in characters.
_MAX_INLINE_LENGTH = 60
# Number of weights per line in the C code of a constant array.
_TABLE_COLUMNS = 6
# Words that cannot be names of variables: keywords of C and C++, macros and functions of the included headers, and
# functions of the exported code.
_RESERVED_WORDS = """
auto bool break case char const continue default do double else enum extern false float for goto if inline int long
register restrict return short signed sizeof static struct switch true typedef union unsigned void volatile while
result results time float_bits number_of acos asin atan atan2 ceil copysign cos cosh erf exp fabs floor fma
multiply_add exact_sum upper_half fmod gamma hypot j0 j1 jn ldexp log log1p pow rint round sin sinh sqrt tan tanh
trunc y0 y1 yn INFINITY NAN NULL I main
and asm catch class compl concept const_cast constexpr decltype delete dynamic_cast explicit export friend mutable
namespace new noexcept not nullptr operator or private protected public reinterpret_cast requires static_assert
static_cast template this throw try typeid typename using virtual wchar_t xor
"""
_RESERVED = frozenset(_RESERVED_WORDS.split())


class Precision(NamedTuple):
    """Floating-point format of exported code.

    Attributes:
        real: C type of a number.
        suffix: suffix of constants and of functions of `math.h`.
        num_bytes: size of a number in memory, bytes.
    """

    real: str
    suffix: str
    num_bytes: int


# Name, suffix of constants and size of the floating-point formats in C.
DOUBLE = Precision("double", "", 8)
SINGLE = Precision("float", "f", 4)
PRECISIONS = {"double": DOUBLE, "single": SINGLE}
"""Floating-point formats of exported code, by name."""


class Functions:
    """Static functions of a C file for elementary functions, branches and network layers.

    Args:
        precision: floating-point format.

    Attributes:
        precision: floating-point format.
        texts: C code of each function, in an order in which each function follows the functions that it calls.
        num_operations: number of operations of one call of each function, by the name of the function.
    """

    def __init__(self, precision: Precision) -> None:
        self.precision, self.texts = precision, list[str]()
        self.num_operations: dict[str, int] = {}
        self._names: dict[Function | Branch | SymbolLayer, str] = {}

    def elementary(self, function: Function) -> tuple[str, ...] | str:
        """Return the name of the static function that computes an elementary function.

        In single precision, return a tuple instead: the name of a function of `math.h` for each result.
        """
        if self.precision is SINGLE:
            return _SINGLE_PRECISION_FUNCTIONS[function.name]
        return self._named(function, f"approximate_{function.name}", self._branch_text, function.approximation)

    def branch(self, branch: Branch) -> str:
        """Return the name of the static function for a branch."""
        return self._named(branch, f"branch_{len(self._names)}", self._branch_text, branch)

    def layer(self, layer: SymbolLayer) -> str:
        """Return the name of the static function for a network layer."""
        return self._named(layer, f"layer_{len(self._names)}", self._layer_text, layer)

    def _named(
        self,
        key: Function | Branch | SymbolLayer,
        name: str,
        text: Callable[[str, Branch], str] | Callable[[str, SymbolLayer], str],
        body: Branch | SymbolLayer,
    ) -> str:
        if key not in self._names:
            self._names[key] = name
            self.texts.append(text(name, body))  # type: ignore[arg-type]
        return self._names[key]

    def _branch_text(self, name: str, branch: Branch) -> str:
        """Return the C code of a branch as a function, which returns a single result or writes several to an array."""
        real = self.precision.real
        rows = sorted(
            {
                (index, operation.kind)
                for operation in branch.operations
                if operation.name == "row"
                for _, index in [operation.operands]
            }
        )
        kinds = dict(rows)
        num_rows = max(kinds, default=-1) + 1
        arguments = [
            f"{_TYPES[kinds.get(index, SymbolKind.NUMBER)].format(real=real)} x{index}" for index in range(num_rows)
        ]
        listing = branch.listing
        results = [Symbol(listing, line, branch.operations[line].kind) for line in branch.results]
        body = Body(listing, results, row=lambda group, index: f"x{index}", functions=self)
        self.num_operations[name] = body.num_operations
        if len(results) == 1:
            kind = _TYPES[results[0].kind].format(real=real)
            lines = [*body.lines, f"return {body.results[0].text};"]
            return function_text(f"static {kind} {name}({', '.join(arguments)})", lines)
        stores = [f"results[{index}] = {result.text};" for index, result in enumerate(body.results)]
        unused = [f"(void)x{index};" for index in range(num_rows) if index not in kinds]
        head = f"static void {name}({', '.join([*arguments, f'{real} results[{len(results)}]'])})"
        return function_text(head, [*unused, *body.lines, *stores])

    def _layer_text(self, name: str, layer: SymbolLayer) -> str:
        real, (rows, columns) = self.precision.real, layer.matrix.shape
        biases, weights = zip(*layer.matrix.biases_and_weights(), strict=True)
        activation, listing = layer.activation, layer.activation.listing
        (line,) = activation.results
        result = Symbol(listing, line, activation.operations[line].kind)
        body = Body(listing, [result], row=lambda group, index: "sum", functions=self)
        self.num_operations[name] = rows * (2 * columns + body.num_operations)
        tables = [
            *_table(f"static const {real} {name}_biases[{rows}]", [biases], self.precision),
            *_table(f"static const {real} {name}_weights[{rows}][{columns}]", weights, self.precision),
        ]
        lines = [
            f"for (int i = 0; i < {rows}; ++i) {{",
            f"    {real} sum = {name}_biases[i];",
            f"    for (int j = 0; j < {columns}; ++j)",
            f"        sum = sum + {name}_weights[i][j] * inputs[j];",
            *(f"    {line}" for line in body.lines),
            f"    results[i] = {body.results[0].text};",
            "}",
        ]
        head = f"static void {name}(const {real} inputs[{columns}], {real} results[{rows}])"
        return "\n".join([*tables, "", function_text(head, lines)])


def function_text(head: str, lines: Sequence[str]) -> str:
    """Return the C code of a function, given its head and the lines of its body."""
    return "\n".join([*wrapped(head), "{", *(each for line in lines for each in wrapped(f"    {line}")), "}", ""])


def wrapped(line: str, width: int = 118) -> list[str]:
    """Return a line of C code, broken after commas, operators and equals signs if it is longer than `width`."""
    indent = len(line) - len(line.lstrip()) + 4
    pieces = []
    while len(line) > width:
        places = [match.end() for match in re.finditer(r"[,=+*/?:-] ", line[:width])]
        place = next((place for place in reversed(places) if place > indent), 0)
        if not place:
            break
        pieces.append(line[:place].rstrip())
        line = " " * indent + line[place:]
    return [*pieces, line]


def constant_text(value: float, precision: Precision) -> str:
    """Return the shortest decimal text from which a compiler reads the same number.

    In single precision, numbers that are too small or too large are replaced by the nearest normal number. Formulas use
    tiny numbers to avoid divisions by zero, so these numbers must not become zero.
    """
    if np.isnan(value):
        return "NAN"
    if np.isinf(value):
        return "INFINITY" if value > 0.0 else "-INFINITY"
    if precision is SINGLE and value != 0.0:
        limits = np.finfo(np.float32)
        size = min(max(abs(value), float(limits.smallest_normal)), float(limits.max))
        text = str(np.float32(math.copysign(size, value)))
    else:
        text = repr(float(value))
    return text + ("" if "." in text or "e" in text else ".0") + precision.suffix


def _table(head: str, rows: Sequence[Sequence[float]], precision: Precision) -> list[str]:
    """Return the definition of a constant array with one or several rows."""
    texts = [[constant_text(value, precision) for value in row] for row in rows]
    lines = [
        [", ".join(row[first : first + _TABLE_COLUMNS]) for first in range(0, len(row), _TABLE_COLUMNS)]
        for row in texts
    ]
    if len(lines) == 1 and head.count("[") == 1:
        return [f"{head} = {{", *(f"    {line}," for line in lines[0]), "};"]
    blocks = [["    {", *(f"        {line}," for line in row), "    },"] for row in lines]
    return [f"{head} = {{", *(line for block in blocks for line in block), "};"]


def identifier(name: str) -> str:
    """Return a valid C identifier for a name: invalid characters become underscores, reserved words get a suffix."""
    name = re.sub(r"\W", "_", name, flags=re.ASCII)
    name = name if name[:1].isalpha() or name[:1] == "_" else f"_{name}"
    return f"{name}_" if name in _RESERVED else name


class Body:
    """Statements that compute the results of a listing.

    Args:
        listing: listing, recorded with `calls_functions`.
        results: symbols or numbers of the results.
        row: function that returns the expression of an input value, given the number of its group of inputs and its
            index in this group.
        functions: static functions of the C file, to which required functions are added.
        names: names for the values of lines, by the number of the line.
        reserved: names that local variables must not have.

    Attributes:
        lines: statements.
        results: expressions of the results.
        num_operations: number of arithmetic operations, comparisons and calls of functions of `math.h`, including
            those of called functions.
    """

    def __init__(
        self,
        listing: Listing,
        results: Sequence[Symbol | float],
        *,
        row: Callable[[int, int], str],
        functions: Functions,
        names: Mapping[int, str] | None = None,
        reserved: Sequence[str] = (),
    ) -> None:
        self.lines: list[str] = []
        self.num_operations = 0
        self._operations, self._row, self._functions = listing.operations, row, functions
        self._names, self._taken = names or {}, {*reserved}
        self._expressions: dict[int, Expression] = {}
        self._arrays: dict[tuple[object, tuple[int, ...]], str] = {}
        self._one = Expression(constant_text(1.0, functions.precision), _ATOM_PRECEDENCE)
        symbols = [result if isinstance(result, Symbol) else listing.constant(result) for result in results]
        self._operations = listing.operations
        self._uses = self._count_uses([symbol.line for symbol in symbols])
        for line, uses in enumerate(self._uses):
            if uses:
                self._expressions[line] = self._expression(line)
        self.results = [self._expressions[symbol.line] for symbol in symbols]

    def _count_uses(self, results: Sequence[int]) -> list[int]:
        """Return how often each line is used by the results and by the lines that are needed for them."""
        uses = [0] * len(self._operations)
        for line in results:
            uses[line] += 1
        for line in reversed(range(len(uses))):
            operation = self._operations[line]
            if uses[line] and operation.name not in LEAVES:
                for operand in operation.operands:
                    uses[operand] += 1
        return uses

    def _expression(self, line: int) -> Expression:
        operation = self._operations[line]
        if operation.name in LEAVES:
            return self._leaf(line)
        if operation.called_part is not None:
            return self._call_result(line)
        operands = [self._expressions[operand] for operand in operation.operands]
        if operation.name == "multiply" and self._one in operands:
            # A multiplication by one is omitted.
            return operands[0] if operands[1] == self._one else operands[1]
        self.num_operations += 1
        template = self._template(line)
        texts = [
            text if precedence >= min_precedence else f"({text})"
            for (text, precedence), min_precedence in zip(operands, template.min_precedences, strict=True)
        ]
        text = template.text.format(*texts, f=self._functions.precision.suffix)
        return self._inlined_or_assigned(line, Expression(text, template.precedence))

    def _template(self, line: int) -> _Template:
        operation = self._operations[line]
        first = self._operations[operation.operands[0]].kind
        if operation.name in _LOGICAL and first is SymbolKind.TRUTH:
            return _LOGICAL[operation.name]
        tables = _BITWISE if operation.name in _BITWISE and first is not SymbolKind.NUMBER else EXPRESSIONS
        return tables[operation.name]

    def _leaf(self, line: int) -> Expression:
        operation = self._operations[line]
        if operation.name == "row":
            group, index = operation.operands
            return Expression(self._row(group, index), _ATOM_PRECEDENCE)
        (bits,) = operation.operands
        if operation.name == "shared":
            return Expression("time", _ATOM_PRECEDENCE)
        if operation.kind is SymbolKind.NUMBER:
            text = constant_text(float(np.uint64(bits).view(np.float64)), self._functions.precision)
            return Expression(text, _UNARY_PRECEDENCE if text.startswith("-") else _ATOM_PRECEDENCE)
        if operation.kind is SymbolKind.TRUTH:
            return Expression("true" if bits else "false", _ATOM_PRECEDENCE)
        return Expression(f"{bits}" if bits < _MIN_HEXADECIMAL_WORD else f"UINT64_C({bits:#x})", _ATOM_PRECEDENCE)

    def _inlined_or_assigned(self, line: int, expression: Expression) -> Expression:
        """Return an expression unchanged if it is short and used once; otherwise return a variable with its value."""
        is_short = len(expression.text) <= _MAX_INLINE_LENGTH
        if self._uses[line] == 1 and line not in self._names and is_short:
            return expression
        name = self._variable(self._names.get(line, "t"), always_numbered=line not in self._names)
        kind = _TYPES[self._operations[line].kind].format(real=self._functions.precision.real)
        self.lines.append(f"const {kind} {name} = {expression.text};")
        return Expression(name, _ATOM_PRECEDENCE)

    def _variable(self, name: str, *, always_numbered: bool = False) -> str:
        """Return a new name of a local variable."""
        base = identifier(name)
        name, number = f"{base}1" if always_numbered else base, 2
        while name in self._taken:
            name, number = f"{base}{'' if always_numbered else '_'}{number}", number + 1
        self._taken.add(name)
        return name

    def _call_result(self, line: int) -> Expression:
        """Return the expression for one result of a branch, layer or function, and append its call if necessary."""
        operation = self._operations[line]
        assert operation.called_part is not None
        assert operation.kind is not SymbolKind.WORD, "arrays of results contain numbers"
        part, index = operation.called_part
        if isinstance(part, Function):
            names = self._functions.elementary(part)
            arguments = ", ".join(self._expressions[operand].text for operand in operation.operands)
            if isinstance(names, tuple):
                self.num_operations += 1
                return self._inlined_or_assigned(line, Expression(f"{names[index]}({arguments})", _ATOM_PRECEDENCE))
            if len(part.approximation.results) == 1:
                self.num_operations += self._functions.num_operations[names]
                return self._inlined_or_assigned(line, Expression(f"{names}({arguments})", _ATOM_PRECEDENCE))
        key = part, operation.operands
        if key not in self._arrays:
            self._arrays[key] = self._append_call(part, operation.operands)
        return self._inlined_or_assigned(line, Expression(f"{self._arrays[key]}[{index}]", _ATOM_PRECEDENCE))

    def _append_call(self, part: Branch | SymbolLayer | Function, operands: tuple[int, ...]) -> str:
        """Append a call with several results, and return the name of the array of its results."""
        real = self._functions.precision.real
        texts = [self._expressions[operand].text for operand in operands]
        match part:
            case Branch():
                name, count, (mask, *texts) = self._functions.branch(part), len(part.results), texts
            case SymbolLayer():
                name, count, mask = self._functions.layer(part), part.matrix.num_rows, ""
                texts = [self._array(texts)]
            case Function():
                name, count, mask = str(self._functions.elementary(part)), len(part.approximation.results), ""
        self.num_operations += self._functions.num_operations[name]
        results = self._variable(f"{name.removeprefix('approximate_')}_results")
        self.lines.append(f"{real} {results}[{count}]{' = {0}' if mask else ''};")
        condition = f"if ({mask}) " if mask else ""
        if isinstance(part, Branch) and count == 1:
            self.lines.append(f"{condition}{results}[0] = {name}({', '.join(texts)});")
        else:
            self.lines.append(f"{condition}{name}({', '.join([*texts, results])});")
        return results

    def _array(self, texts: Sequence[str]) -> str:
        """Return the name of an array with the given elements."""
        name = texts[0].partition("[")[0]
        if texts == [f"{name}[{index}]" for index in range(len(texts))]:
            return name
        array = self._variable("inputs")
        self.lines.append(f"const {self._functions.precision.real} {array}[{len(texts)}] = {{{', '.join(texts)}}};")
        return array
