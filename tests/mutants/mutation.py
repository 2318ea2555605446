"""Mutants of a Python source text. A mutant is the text with one small change that a test should detect.

The changes are chosen for formulas. There are four changes in addition to the usual ones: removal of an addend or
factor, removal of a clamp, replacement of a sine with a cosine, and exchange of neighbours (arguments, elements of a
tuple, targets of an assignment).

Some changes are omitted, because either no test or every test detects them:

- changes of texts, messages, annotations, decorators, imports and lists of names
- `<` in place of `<=` between numbers that are not integers
- removal of a keyword argument, since most keyword arguments are required
- changes of `strict` in zip, and of SciPy's options for input checks and in-place operation
- exchanges of names that are assigned equal values
- another sample in linspace, or an increment of a private constant that is a number of iterations or a size
- changes of sizes, distances, widths and transparency in figures, which only a person can judge
"""

import ast
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple


class Mutant(NamedTuple):
    """Source text with one change.

    Attributes:
        line: number of the line at which the change begins, from 1 on.
        lines: lines of the enclosing statement without its body. A default value of a parameter has the lines of the
            whole function.
        declared: True if the changed code runs when the module is imported.
        kind: kind of the change, such as "operator".
        before: original lines, joined into one.
        after: the same lines after the change, joined into one.
        span: indices of the first replaced byte, and of the byte after the last replaced byte.
        code: text that replaces these bytes.
    """

    line: int
    lines: range
    declared: bool
    kind: str
    before: str
    after: str
    span: tuple[int, int]
    code: str

    def applied(self, text: str) -> str:
        """Return the text with this change."""
        begin, end = self.span
        return (text.encode()[:begin] + self.code.encode() + text.encode()[end:]).decode()


_ARITHMETIC_REPLACEMENTS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
    ast.Pow: ast.Mult, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult,
}  # fmt: skip
_OPPOSITE_COMPARISONS = {
    ast.Lt: ast.GtE, ast.GtE: ast.Lt, ast.Gt: ast.LtE, ast.LtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
_BOUNDARY_COMPARISONS = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
COUNTERPARTS = {
    name: other
    for pair in ("sin cos", "minimum maximum", "min max", "argmin argmax", "any all", "floor ceil", "zeros ones")
    for name, other in (pair.split(), pair.split()[::-1])
}
# Functions whose call a mutant replaces with one of its arguments.
_CLAMPS = {"minimum", "maximum", "min", "max"}
_TRANSFORMS = {"abs", "sqrt", "wrap_angle", "floor", "ceil", "round", "rint", "clip", "sorted", "cumsum"}
# Functions whose arguments no mutant exchanges, because the exchange would have no effect, or would always be an error.
_FUNCTIONS_WITH_FIXED_ARGUMENT_ORDER = {
    *_CLAMPS, "hypot", "plus", "judge", "isinstance", "getattr", "setattr", "cast", "partial", "suppress", "TypeVar",
    "NewType", "swapaxes", "array_equal",
}  # fmt: skip
# Functions that return a new array, whose values depend only on the arguments.
_ARRAY_CONSTRUCTORS = {"zeros", "zeros_like", "ones", "ones_like", "empty", "empty_like", "full", "full_like"}

# Arguments that affect the checks of zip or SciPy, but not the results.
_CHECK_ARGUMENTS = {"strict", "check_finite", "overwrite_b"}
# Arguments of Matplotlib that affect the appearance of a figure, but not its contents.
_APPEARANCE_ARGUMENTS = {
    "alpha", "annotation_clip", "bbox_to_anchor", "borderaxespad", "capsize", "clip_on", "columnspacing", "dpi",
    "edgecolor", "facecolor", "figsize", "fontsize", "fraction", "height_ratios", "labelpad", "linewidth", "linewidths",
    "lw", "markeredgewidth", "markersize", "ncols", "pad", "rasterized", "shrink", "w_pad",
    "width_ratios", "xytext", "zoom", "zorder",
}  # fmt: skip
# Functions that change only the appearance of a figure.
_STYLING_FUNCTIONS = {
    "align_ylabels", "grid", "new_figure", "set_axisbelow", "set_solid_capstyle", "tick_params",
}  # fmt: skip

_SKIPPED_FIELDS = {"annotation", "returns", "decorator_list", "bases", "type_params", "type"}
_SKIPPED_NODES = (ast.Import, ast.ImportFrom, ast.JoinedStr, ast.Raise, ast.Assert)
_COMPOUND_EXPRESSIONS = (ast.BinOp, ast.UnaryOp, ast.BoolOp, ast.Compare, ast.IfExp, ast.Lambda)
_BINDING_EXPRESSIONS = (*_COMPOUND_EXPRESSIONS, ast.Attribute, ast.Subscript, ast.Starred)


def mutants_of(text: str) -> list[Mutant]:
    """Return all mutants of a Python source text."""
    source, starts, mutants = text.encode(), [0], []
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))
    for node, parent, lines, declared in _visit_nodes(ast.parse(text)):
        for kind, new in _changes(node, parent):
            first, last = starts[node.lineno - 1], starts[node.end_lineno]
            begin, end = first + node.col_offset, starts[node.end_lineno - 1] + node.end_col_offset
            code = ast.unparse(new)
            enclosed = (source[begin - 1 : begin], source[end : end + 1]) == (b"(", b")")
            if isinstance(new, _COMPOUND_EXPRESSIONS) and isinstance(parent, _BINDING_EXPRESSIONS) and not enclosed:
                code = f"({code})"
            if isinstance(new, ast.Tuple) and isinstance(parent, ast.Subscript):
                code = code[1:-1]
            before = _in_one_line(source[first:last])
            after = _in_one_line(source[first:begin] + code.encode() + source[end:last])
            if after != before:
                mutants.append(Mutant(node.lineno, lines, declared, kind, before, after, (begin, end), code))
    return mutants


def _in_one_line(text: bytes) -> str:
    return " ".join(text.decode().split())


def _visit_nodes(module: ast.Module) -> Iterator[tuple[ast.AST, ast.AST, range, bool]]:
    """Yield each node that may change, its parent, the lines that it affects, and whether it runs at import."""
    pending: list[tuple[ast.AST, ast.AST, range, bool]] = [(node, module, range(0), True) for node in module.body]
    while pending:
        node, parent, lines, declared = pending.pop()
        if isinstance(node, ast.stmt):
            body = [case.pattern for case in node.cases] if isinstance(node, ast.Match) else getattr(node, "body", None)
            lines = range(node.lineno, body[0].lineno if body else node.end_lineno + 1)
            lines = lines or range(node.lineno, node.lineno + 1)
        if isinstance(node, ast.arguments) and isinstance(parent, ast.FunctionDef):
            lines, declared = range(parent.lineno, parent.end_lineno + 1), False
        if _is_declaration_of_names(node) or (isinstance(node, ast.Expr) and _is_styling(node.value)):
            continue
        yield node, parent, lines, declared
        if isinstance(node, _SKIPPED_NODES) or _is_styling(node):
            continue
        for field, value in ast.iter_fields(node):
            if field in _SKIPPED_FIELDS or (isinstance(node, ast.ClassDef) and field == "keywords"):
                continue
            if _is_inferred_dimension(node, parent):
                continue
            inside = declared and not (isinstance(node, ast.FunctionDef) and field == "body")
            for index, child in enumerate(value if isinstance(value, list) else [value]):
                if isinstance(child, ast.AST) and not _is_appearance(node, field, index):
                    pending.append((child, node, lines, inside))


def _is_styling(node: ast.AST) -> bool:
    """Return whether a node affects only the appearance of a figure."""
    if isinstance(node, ast.keyword):
        return node.arg in _APPEARANCE_ARGUMENTS
    return (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute | ast.Name)
        and _name(node) in _STYLING_FUNCTIONS
    )


def _is_appearance(node: ast.AST, field: str, index: int) -> bool:
    """Return whether a part of a node affects only appearance, such as the distance of a label from its point."""
    if isinstance(node, ast.Dict) and field == "values":
        key = node.keys[index]
        return isinstance(key, ast.Constant) and key.value in _APPEARANCE_ARGUMENTS
    return isinstance(node, ast.Call) and field == "args" and _name(node) == "annotate" and index == 2


def _name(call: ast.Call) -> str:
    """Return the name of the function that a call calls; empty if the function has no name."""
    return call.func.id if isinstance(call.func, ast.Name) else getattr(call.func, "attr", "")


def _is_inferred_dimension(node: ast.AST, parent: ast.AST) -> bool:
    """Return whether a node is -1 in a call of reshape, where NumPy accepts any negative number."""
    called = isinstance(parent, ast.Call) and isinstance(parent.func, ast.Attribute) and parent.func.attr == "reshape"
    return called and isinstance(node, ast.UnaryOp)


def _is_declaration_of_names(node: ast.AST) -> bool:
    """Return whether a node is `__all__`, a block for type checkers, or a type alias."""
    if isinstance(node, ast.If):
        return isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
    if not isinstance(node, ast.Assign) or not isinstance(node.targets[0], ast.Name):
        return False
    value = node.value
    return node.targets[0].id == "__all__" or (
        isinstance(value, ast.Subscript)
        and isinstance(value.value, ast.Name)
        and value.value.id in ("Callable", "tuple")
    )


def _changes(node: ast.AST, parent: ast.AST) -> Iterator[tuple[str, ast.AST]]:
    """Yield each change of a node: the kind of change, and the changed node."""
    if getattr(parent, "test", None) is node and not isinstance(node, ast.Compare | ast.BoolOp):
        yield "condition", ast.UnaryOp(ast.Not(), node)
    match node:
        case ast.BinOp(left, operator, right) if type(operator) in _ARITHMETIC_REPLACEMENTS:
            yield "operator", ast.BinOp(left, _ARITHMETIC_REPLACEMENTS[type(operator)](), right)
            yield "operand", left
            yield "operand", right
        case ast.AugAssign(target, operator, value):
            if type(operator) in _ARITHMETIC_REPLACEMENTS:
                yield "operator", ast.AugAssign(target, _ARITHMETIC_REPLACEMENTS[type(operator)](), value)
            yield "statement", ast.Pass()
        case ast.UnaryOp(ast.USub(), operand):
            yield "sign", operand
        case ast.Compare(left, [operator], [right]):
            yield "condition", ast.Compare(left, [_OPPOSITE_COMPARISONS[type(operator)]()], [right])
            if type(operator) in _BOUNDARY_COMPARISONS and (_is_integer(left) or _is_integer(right)):
                yield "boundary", ast.Compare(left, [_BOUNDARY_COMPARISONS[type(operator)]()], [right])
        case ast.Compare(left, [first, *others], rights):
            yield "condition", ast.Compare(left, [_OPPOSITE_COMPARISONS[type(first)](), *others], rights)
        case ast.BoolOp(operator, values):
            yield "condition", ast.BoolOp(ast.Or() if isinstance(operator, ast.And) else ast.And(), values)
        case ast.Constant(int()) if _is_option_or_count(parent):
            return
        case ast.Constant(bool() as value):
            yield "number", ast.Constant(not value)
        case ast.Constant(int() | float() as value):
            yield "number", ast.Constant(value + 1 if value + 1 != value else 2 * value)
        case ast.IfExp(_, body, otherwise):
            yield "condition", body
            yield "condition", otherwise
        case ast.Call(function, arguments, keywords):
            yield from _changes_of_call(node, function, arguments, keywords)
        case ast.Tuple(elements) | ast.List(elements) if not _has_fixed_order(
            parent
        ) and not _have_equal_initial_values(node, parent):
            for swapped in _neighbour_swaps(elements):
                yield "order", type(node)(swapped, node.ctx)
        case ast.Raise() | ast.Continue() | ast.Break() | ast.Expr(ast.Call()):
            yield "statement", ast.Pass()
        case ast.Assign([ast.Attribute() | ast.Subscript()], _):
            yield "statement", ast.Pass()


def _changes_of_call(
    node: ast.Call, function: ast.expr, arguments: list[ast.expr], keywords: list[ast.keyword]
) -> Iterator[tuple[str, ast.AST]]:
    name = _name(node)
    if name in _STYLING_FUNCTIONS:
        return
    if name in COUNTERPARTS:
        other = COUNTERPARTS[name]
        new = ast.Name(other) if isinstance(function, ast.Name) else ast.Attribute(function.value, other)
        yield "function", ast.Call(new, arguments, keywords)
    if name in _CLAMPS and len(arguments) > 1:
        yield from (("function", argument) for argument in arguments)
    if name in _TRANSFORMS and arguments:
        yield "function", arguments[0]
    if name == "where" and len(arguments) == 3:
        yield from (("condition", argument) for argument in arguments[1:])
    if name in _FUNCTIONS_WITH_FIXED_ARGUMENT_ORDER:
        return
    for swapped in _neighbour_swaps(arguments):
        yield "order", ast.Call(function, swapped, keywords)
    significant = [keyword for keyword in keywords if keyword.arg not in _CHECK_ARGUMENTS | _APPEARANCE_ARGUMENTS]
    others = [keyword for keyword in keywords if keyword.arg in _CHECK_ARGUMENTS | _APPEARANCE_ARGUMENTS]
    for values in _neighbour_swaps([keyword.value for keyword in significant]):
        exchanged = [ast.keyword(keyword.arg, value) for keyword, value in zip(significant, values, strict=True)]
        yield "order", ast.Call(function, arguments, exchanged + others)


def _neighbour_swaps(nodes: list[ast.expr]) -> Iterator[list[ast.expr]]:
    """Yield copies of a list, each with two neighbouring items of the same type exchanged."""
    for i, (first, second) in enumerate(pairwise(nodes)):
        if type(first) is type(second) and ast.dump(first) != ast.dump(second) and not _is_text(first):
            yield [*nodes[:i], second, first, *nodes[i + 2 :]]


def _is_option_or_count(parent: ast.AST) -> bool:
    """Return whether a node uses an integer as a check option, as a number of samples, or as a private constant."""
    if isinstance(parent, ast.keyword):
        return parent.arg in _CHECK_ARGUMENTS
    if isinstance(parent, ast.Call):
        return isinstance(parent.func, ast.Attribute) and parent.func.attr == "linspace"
    return isinstance(parent, ast.Assign) and getattr(parent.targets[0], "id", "").startswith("_")


def _has_fixed_order(parent: ast.AST) -> bool:
    """Return whether mutants keep the order of a node's elements, as for the values in `kind in (a, b)`."""
    return isinstance(parent, ast.Compare) or (
        isinstance(parent, ast.Call)
        and isinstance(parent.func, ast.Name)
        and parent.func.id in _FUNCTIONS_WITH_FIXED_ARGUMENT_ORDER
    )


def _have_equal_initial_values(node: ast.AST, parent: ast.AST) -> bool:
    """Return whether the targets of an assignment get equal new values, such as empty lists."""
    if not isinstance(parent, ast.Assign) or node is parent.value or not isinstance(parent.value, ast.Tuple):
        return False
    first, *others = parent.value.elts
    new = isinstance(first, ast.Call) and getattr(first.func, "attr", "") in _ARRAY_CONSTRUCTORS
    empty = ast.unparse(first) in ("[]", "{}")
    return (new or empty) and all(ast.dump(each) == ast.dump(first) for each in others)


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _is_integer(node: ast.expr) -> bool:
    """Return whether a node is an integer literal or a call of `len`."""
    if isinstance(node, ast.Call):
        return isinstance(node.func, ast.Name) and node.func.id == "len"
    return isinstance(node, ast.Constant) and isinstance(node.value, int)
