"""A model's complaints in plain words, each with its place in the file and what to write instead.

Knows pydantic's errors: their kinds, and how their locations follow a document through unions and tags.
"""

from __future__ import annotations

import difflib
import types
import typing
from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel, ValidationError

from sequences.errors import Fault
from sequences.yaml_text import DocumentPath, Tree, path_text

LONGEST_QUOTE = 60
MOST_COMPARED, MOST_TOLD = 50, 30
"""Known words that a wrong one is held against, and that are listed: a file may name thousands of its own."""

PLAIN = {
    "missing": "required, and missing.",
    "float_parsing": "must be a number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "must be a whole number of sensible size",
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
    "string_pattern_mismatch": "must be of the form {pattern}",
    "greater_than": "must be more than {gt:g}",
    "greater_than_equal": "must be {ge:g} or more",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be {le:g} or less",
    "string_too_short": "must not be empty",
    "string_too_long": "must have {max_length} characters or fewer",
    "too_short": "must have at least {min_length} in it",
    "too_long": "must have {max_length} entries or fewer",
}
"""Our words for pydantic's kinds of error; a kind not named here keeps pydantic's own."""


def faults_of(error: ValidationError, tree: Tree, model: type[BaseModel]) -> list[Fault]:
    """All complaints of a model about a document, in words and at their places."""
    return [_fault(complaint, tree, model) for complaint in error.errors(include_url=False)]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Hint at the nearest known word, or at all of them.

    Examples
    --------
    >>> did_you_mean("setle_s", ["settle_s", "record"])
    " Did you mean 'settle_s'?"
    >>> did_you_mean("x", ["pan", "tilt"])
    ' Known here: pan, tilt.'
    """
    names = list(dict.fromkeys(known))
    near = difflib.get_close_matches(word, names[:MOST_COMPARED], n=1)
    if near:
        return f" Did you mean {near[0]!r}?"
    more = f" and {len(names) - MOST_TOLD} more" if len(names) > MOST_TOLD else ""
    return f" Known here: {', '.join(names[:MOST_TOLD])}{more}." if names else ""


def _fault(complaint: Any, tree: Tree, model: type[BaseModel]) -> Fault:
    kind, context = complaint["type"], complaint.get("ctx", {})
    path = _document_path(complaint["loc"], tree, is_missing=kind == "missing")
    spot = tree.spot(path)
    got = _quoted(complaint["input"])
    if kind == "extra_forbidden":
        spot = tree.keys.get(path, spot)
        message = f"unknown key.{did_you_mean(str(path[-1]), _keys_known(model, complaint['loc'][:-1]))}"
    elif kind == "literal_error":
        message = f"must be {context['expected']}{got}.{_nearest(complaint['input'], context['expected'])}"
    elif kind in {"union_tag_invalid", "union_tag_not_found"}:
        name = context["discriminator"].strip("'")
        path = (*path, name)
        spot = tree.spot(path)
        known = _tags(model, complaint["loc"], name)
        message = f"must be one of {', '.join(map(repr, known))}" + (
            f" (got {context['tag']!r})." if "tag" in context else ", and is missing."
        )
    elif kind == "missing":
        message = PLAIN[kind]
    elif kind in PLAIN:
        message = f"{PLAIN[kind].format(**context)}{got}."
    else:
        message = complaint["msg"]
    return Fault(tree.file, *spot, path_text(path), message)


def _document_path(loc: tuple[int | str, ...], tree: Tree, *, is_missing: bool) -> DocumentPath:
    """Turn a complaint's location into the document's path, without the names of unions' branches."""
    path: DocumentPath = ()
    value = tree.value
    for part in loc[:-1] if is_missing else loc:
        if (*path, part) in tree.values:
            path, value = (*path, part), value[part]
        elif part == value:  # a bare word that stands for a mapping
            path = (*path, part)
    return (*path, loc[-1]) if is_missing else path


def _quoted(value: Any) -> str:
    if value is None:
        return " (got nothing)"
    if not isinstance(value, str):
        return ""
    return f" (got {value[:LONGEST_QUOTE]!r}{'...' if len(value) > LONGEST_QUOTE else ''})"


def _nearest(value: Any, expected: str) -> str:
    near = difflib.get_close_matches(
        str(value), expected.replace("'", "").replace(" or ", ", ").split(", "), n=1
    )
    return f" Did you mean {near[0]!r}?" if near else ""


def _keys_known(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Keys that a mapping at a location of the model may have."""
    found = _types_at(model, loc)
    return [key for kind in found if _is_model(kind) for key in kind.model_fields]


def _tags(model: type[BaseModel], loc: tuple[int | str, ...], discriminator: str) -> list[str]:
    """Values of a union's discriminator."""
    fields = [kind.model_fields[discriminator] for kind in _types_at(model, loc) if _is_model(kind)]
    return [tag for each in fields for tag in typing.get_args(each.annotation)]


def _types_at(model: type[BaseModel], loc: tuple[int | str, ...]) -> list[Any]:
    """Types a value at a location may have; a part of it that names a union's branch leaves that branch."""
    found: list[Any] = [model]
    for part in loc:
        inner = [each for kind in found for each in _inner(kind, part)]
        branch = [kind for kind in found if _is_model(kind) and _is_branch(kind, part)]
        found = inner or branch or found
    return found


def _inner(kind: Any, part: int | str) -> list[Any]:
    """Types of what a type holds at a key or index."""
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
    """Whether a tag (a driver's name, say) belongs to this model."""
    return any(part in typing.get_args(field.annotation) for field in kind.model_fields.values())
