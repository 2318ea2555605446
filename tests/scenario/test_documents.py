"""Tests of the YAML parser: the core schema of YAML 1.2, and the errors for what it does not accept."""

import math

import pytest

from drake_quad.errors import InputError
from drake_quad.scenario.files.documents import parse_document
from drake_quad.scenario.limits import MAX_LEVELS


def parsed(text):
    return parse_document(text, "file.yaml").tree.to_python()


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("12", 12), ("+12", 12), ("-12", -12), ("010", 10), ("0o17", 15), ("0x1F", 31),
        ("1.", 1.0), (".5", 0.5), ("-.5e3", -500.0), ("1e3", 1000.0), ("1.5E-3", 0.0015),
        (".inf", math.inf), ("-.Inf", -math.inf), ("true", True), ("FALSE", False), ("~", None),
        ("null", None), ("", None),
        ("on", "on"), ("yes", "yes"), ("12:30", "12:30"), ("2020-01-01", "2020-01-01"), ("0b101", "0b101"),
        ("a_b", "a_b"),
        ("'12'", "12"), ('"true"', "true"), ("|\n  12\n", "12\n"), ("! 12", "12"),
        ("!!str 12", "12"), ("!!float 12", 12.0), ("!!int 12", 12), ("!!null ~", None), ("!!map {a: 1}", {"a": 1}),
        ("[1, [2.0], {a: b}]", [1, [2.0], {"a": "b"}]), ("&x [1]", [1]),
    ],
)  # fmt: skip
def test_values_follow_the_core_schema_of_yaml_1_2(text, value):
    result = parsed(f"key: {text}")["key"]
    assert result == value
    assert type(result) is type(value)


def test_the_yaml_value_nan_is_read_as_a_float():
    assert math.isnan(parsed("key: .nan")["key"])


def test_an_alias_has_the_value_of_its_anchor_and_its_own_line_number():
    tree = parse_document("a: &x {mass: 1}\nb: *x\n&y c: 2\n*y : 3\n".replace("*y :", "d:"), "file.yaml").tree
    assert tree.to_python() == {"a": {"mass": 1}, "b": {"mass": 1}, "c": 2, "d": 3}
    assert str(tree.value["b"].mark) == "file.yaml:2"
    assert str(tree.value["b"].value["mass"].mark) == "file.yaml:1"


def test_an_anchor_may_be_defined_again():
    assert parsed("a: &x 1\nb: *x\nc: &x 2\nd: *x") == {"a": 1, "b": 1, "c": 2, "d": 2}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1_000", "file.yaml:1: '1_000' is not a valid number"),
        ("a: 1\nb: !!int x", "file.yaml:2: 'x' is not a valid number"),
        ("a: !!bool 1", "file.yaml:1: '1' is not true or false"),
        ("a: !!null x", "file.yaml:1: 'x' is not null"),
        ("a: !!set {x}", "file.yaml:1: the tag tag:yaml.org,2002:set is not allowed"),
        ("a: !!int [1]", "file.yaml:1: the tag tag:yaml.org,2002:int is not allowed"),
        ("a: !mine 1", "file.yaml:1: the tag !mine is not allowed"),
        ("a: *x\nb: &x 1", r"file.yaml:1: is not YAML: the alias \*x must come after the value with its anchor"),
        ("a: &x\n  b: *x", r"file.yaml:2: is not YAML: the alias \*x must come after the value with its anchor"),
        ("? [1]\n: 2", "file.yaml:1: the name of a field must be text"),
        ("a: 1\n\n---\nb: 2", "file.yaml:3: is not YAML: expected a single document, but another begins here"),
        ("a: [1\nb: 2", "file.yaml:2: is not YAML: did not find expected ',' or ']'"),
        ("a: 1\nb: \x07", r"file.yaml:2: is not YAML: it contains the character '\\x07', which YAML does not allow"),
        ("a: 1\nb: \udc80", r"file.yaml:2: is not YAML: it contains the character '\\udc80', which YAML does not"),
    ],
)
def test_errors_give_the_line_and_the_reason(text, message):
    with pytest.raises(InputError, match=f"^{message}"):
        parsed(text)


def test_a_byte_order_mark_may_begin_the_text():
    assert parsed("\ufeffa: 1") == {"a": 1}
    with pytest.raises(InputError, match=r"^file.yaml:1: .* the character '\\x07'"):
        parsed("\ufeffa: \x07")


def test_the_content_of_an_alias_counts_towards_the_limits():
    doubled = "a0: &a0 [1]\n" + "".join(f"a{i + 1}: &a{i + 1} [*a{i}, *a{i}]\n" for i in range(30))
    with pytest.raises(InputError, match=r"^file.yaml:1\d: is too large"):
        parsed(doubled)
    nested = "a0: &a0 [1]\n" + "".join(f"a{i + 1}: &a{i + 1} [*a{i}]\n" for i in range(60))
    with pytest.raises(InputError, match=r"^file.yaml:3\d: is nested too deeply"):
        parsed(nested)


def nested(levels, content):
    return "[" * levels + content + "]" * levels


def test_the_size_of_a_document_is_its_number_of_keys_and_values():
    assert parse_document("a: 1", "file.yaml").nodes == 3
    assert parse_document("", "file.yaml").nodes == 1
    assert parse_document("a: &x [1, 2]\nb: *x", "file.yaml").nodes == 9


def test_a_document_may_have_as_many_levels_as_the_limit():
    assert parsed(nested(MAX_LEVELS - 1, "1"))
    with pytest.raises(InputError, match="^file.yaml:1: is nested too deeply"):
        parsed(nested(MAX_LEVELS, "1"))


def test_an_alias_has_the_levels_of_its_own_content():
    deep = MAX_LEVELS - 3
    assert parsed(f"a: {nested(deep, '1')}\nb: &x [1]\nc: {nested(deep, '*x')}")
    with pytest.raises(InputError, match="^file.yaml:2: is nested too deeply"):
        parsed(f"a: &x [{nested(20, '1')}, 1]\nb: {nested(20, '*x')}")


def test_errors_of_an_override_name_no_line():
    for text in ("a: \x07", "a: [", "a: 1_0", "a: *x"):
        with pytest.raises(InputError, match="^override: "):
            parse_document(text, "override", with_line_numbers=False)
