"""From pydantic's errors, also inside tagged unions, to faults: plain words, the place, and what to write."""

from __future__ import annotations

import difflib
import re
import types
import typing
from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel, ValidationError

from sequences.tree import DocumentPath, Fault, Tree, path_text

LONGEST_QUOTE = 60
"""Characters of a wrong value that a message quotes at most."""
MOST_COMPARED = 50
"""Known words that an unknown word is compared with at most; a file may define thousands of names."""
MOST_LISTED = 30
"""Known words that a message lists at most."""

MESSAGES = {
    "missing": "this key is required, but it is missing.",
    "float_parsing": "must be a number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "must be a smaller whole number",
    "int_from_float": "must be a whole number",
    "int_type": "must be a whole number",
    "bool_parsing": "must be true or false",
    "bool_type": "must be true or false",
    "string_type": "must be text",
    "list_type": "must be a list",
    "tuple_type": "must be a list",
    "dict_type": "must be a mapping (key: value)",
    "model_type": "must be a mapping (key: value)",
    "model_attributes_type": "must be a mapping (key: value)",
    "form": "must be {words}",
    "greater_than": "must be more than {gt:g}",
    "greater_than_equal": "must be {ge:g} or more",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be {le:g} or less",
    "outside": "must be from {lowest} to {highest}{unit}{sign}",
    "plain_number": "{what}",
    "none_or_values": "must be 'none' or a mapping (key: value)",
    "string_too_short": "must not be empty",
    "string_too_long": "must have {max_length} or fewer characters",
    "too_short": "must have {min_length} or more entries",
    "too_long": "must have {max_length} or fewer entries",
}
"""Message for each of pydantic's kinds of error; other kinds keep pydantic's own message."""

_POINT = "Write a decimal point"
_NUMBER = r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*"
_NUMBERS_OF_PEOPLE = {
    r"[-+]?\d+,\d{3}(,\d{3})*(\.\d+)?": f"{_POINT}, and no mark between thousands.",
    r"[-+]?\d*,\d+": f"{_POINT}.",
    r"[\u2212\u2013]\s*[\d.]+.*": "Write the minus sign of the keyboard: -.",
    rf"{_NUMBER}%": "Write a share: 1 % is 0.01.",
    rf"{_NUMBER}ppm": "Write a share: 1 ppm is 1e-6.",
    rf"{_NUMBER}[^\d\s.,:'xeE+-].*": "Write the number alone, in the unit of this key.",
}
"""What to write instead of numbers of these forms."""


def faults_of(error: ValidationError, tree: Tree, model: type[BaseModel]) -> list[Fault]:
    """Return a fault for each of pydantic's errors, in its order."""
    return [_fault(issue, tree, model) for issue in error.errors(include_url=False)]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return a hint for an unknown word, after a space: the most similar known word, or all; empty without any.

    >>> did_you_mean("setle_s", ["settle_s", "record"])
    " Did you mean 'settle_s'?"
    >>> did_you_mean("x", ["pan", "tilt"])
    ' Known here: pan, tilt.'
    """
    names = list(dict.fromkeys(known))
    near = difflib.get_close_matches(word, names[:MOST_COMPARED], n=1)
    if near:
        return f" Did you mean {near[0]!r}?"
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return f" Known here: {', '.join(names[:MOST_LISTED])}{more}." if names else ""


def _fault(issue: Any, tree: Tree, model: type[BaseModel]) -> Fault:
    kind, context = issue["type"], issue.get("ctx", {})
    path = _document_path(issue["loc"], tree, is_missing=kind == "missing")
    spot = tree.spot(path)
    got = _quoted(issue["input"])
    if kind == "extra_forbidden":
        spot = tree.keys.get(path, spot)
        message = _about_unknown_key(str(path[-1]), _types_at(model, issue["loc"][:-1]))
    elif kind == "literal_error":
        message = f"must be {context['expected']}{got}.{_nearest(issue['input'], context['expected'])}"
    elif kind in {"union_tag_invalid", "union_tag_not_found"}:
        name = context["discriminator"].strip("'")
        path = (*path, name)
        spot = tree.spot(path)
        known = _tags(model, issue["loc"], name)
        message = f"must be one of {', '.join(map(repr, known))}" + (
            f" (got {context['tag']!r})." if "tag" in context else ", but it is missing."
        )
    elif kind == "missing":
        message = MESSAGES[kind]
    elif kind in MESSAGES:
        hint = _about_number(issue["input"], path) if kind in {"float_parsing", "int_parsing"} else ""
        if kind == "too_long" and len(issue["input"]) == 2 * context["max_length"]:
            hint = f" {_POINT}, if these are decimals: a comma separates."
        message = f"{MESSAGES[kind].format(**context)}{got}.{hint}"
    elif kind == "value_error":
        message = str(context["error"])
    else:
        message = issue["msg"]
    return Fault(tree.file, *spot, path_text(path), message)


def _document_path(loc: tuple[int | str, ...], tree: Tree, *, is_missing: bool) -> DocumentPath:
    """Convert pydantic's location into the document's path: leave out the names of a union's branches."""
    path: DocumentPath = ()
    value = tree.value
    for part in loc[:-1] if is_missing else loc:
        if (*path, part) in tree.values:
            path, value = (*path, part), value[part]
        elif part == value:  # a bare word in place of a mapping
            path = (*path, part)
    return (*path, loc[-1]) if is_missing else path


def _quoted(value: Any) -> str:
    if value is None:
        return " (got nothing)"
    if not isinstance(value, str):
        return ""
    return f" (got {value[:LONGEST_QUOTE]!r}{'...' if len(value) > LONGEST_QUOTE else ''})"


def _about_number(value: Any, path: DocumentPath = ()) -> str:
    """Return what to write instead of a number as people write it.

    >>> _about_number("255,03"), _about_number("0.02 %"), _about_number("ten")
    (' Write a decimal point.', ' Write a share: 1 % is 0.01.', '')
    """
    text = str(value).strip()
    if path and str(path[-1]).endswith("percent"):
        text = text.replace("%", " percent")
    forms = (hint for pattern, hint in _NUMBERS_OF_PEOPLE.items() if re.fullmatch(pattern, text))
    return f" {hint}" if (hint := next(forms, "")) else ""


def _nearest(value: Any, expected: str) -> str:
    near = difflib.get_close_matches(
        str(value), expected.replace("'", "").replace(" or ", ", ").split(", "), n=1
    )
    return f" Did you mean {near[0]!r}?" if near else ""


def _about_unknown_key(key: str, kinds: Iterable[Any]) -> str:
    """Return the sentence about a key that a mapping, of one of these types, does not have."""
    if key.isdecimal():
        return f"unknown key. {_POINT}, if this is a decimal: a comma separates."
    models = [kind for kind in kinds if _is_model(kind)]
    return f"unknown key.{did_you_mean(key, (name for kind in models for name in kind.model_fields))}"


def _tags(model: type[BaseModel], loc: tuple[int | str, ...], discriminator: str) -> list[str]:
    """Return the values that the discriminator of a union may have."""
    fields = [kind.model_fields[discriminator] for kind in _types_at(model, loc) if _is_model(kind)]
    return [tag for each in fields for tag in typing.get_args(each.annotation)]


def _types_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[Any]:
    """Return the types that a value at a location may have; a part that names a union's branch selects that branch."""
    kinds: list[Any] = [model]
    for part in loc:
        inner = [each for kind in kinds for each in _inner(kind, part)]
        branch = [kind for kind in kinds if _is_model(kind) and _is_branch(kind, part)]
        kinds = inner or branch or kinds
    return kinds


def _inner(kind: Any, part: int | str) -> list[Any]:
    """Return the types that a type holds at a key or index."""
    if _is_model(kind):
        field = kind.model_fields.get(part)
        return _alternatives(field.annotation) if field else []
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in {list, tuple} and isinstance(part, int):
        return _alternatives(arguments[0])
    if origin is dict:
        return _alternatives(arguments[1])
    return []


def _alternatives(annotation: Any) -> list[Any]:
    origin = typing.get_origin(annotation)
    if origin is typing.Annotated:
        return _alternatives(typing.get_args(annotation)[0])
    if origin in {typing.Union, types.UnionType}:
        return [each for argument in typing.get_args(annotation) for each in _alternatives(argument)]
    return [annotation]


def _is_model(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def _is_branch(kind: Any, part: int | str) -> bool:
    """Whether a tag, for example a driver's name, belongs to this model."""
    return any(part in typing.get_args(field.annotation) for field in kind.model_fields.values())
