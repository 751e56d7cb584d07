"""Describes valid values of a recipe's field for which pydantic reports an error."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pydantic_core import ErrorDetails

from mazebot.common.problems import words
from mazebot.worldgen.recipe.recipe_fields import fields_of


def must_of(problem: ErrorDetails, outer: Iterable[Any]) -> str:
    """A valid value, in words. `outer` are the types that contain the location."""
    context = problem.get("ctx", {})
    match problem["type"]:
        case "missing":
            return "is missing"
        case "extra_forbidden":
            return f"unknown field: must be one of {', '.join(fields_of(list(outer)))}"
        case "greater_than":
            return f"must be > {context['gt']:g}"
        case "greater_than_equal":
            return f"must be >= {context['ge']:g}"
        case "less_than_equal":
            return f"must be <= {context['le']:g}"
        case "finite_number":
            return "must be finite"
        case "float_type" | "float_parsing":
            return "must be a number"
        case "int_type" | "int_parsing" | "int_from_float":
            return "must be an integer"
        case "bool_type":
            return "must be true or false"
        case "string_type" | "invalid_key":
            return "must be a string"
        case "string_pattern_mismatch":
            return "must be letters, digits, `_`, `.` and `-`, and begin with a letter or digit"
        case "string_too_short":
            return f"must have at least {context['min_length']} characters"
        case "string_too_long":
            return f"must have at most {context['max_length']} characters"
        case "too_short":
            return f"must have at least {context['min_length']} items"
        case "too_long":
            return f"must have at most {context['max_length']} items"
        case "model_type" | "dict_type" | "model_attributes_type":
            return "must be a mapping of fields to values"
        case "tuple_type":
            return "must be a list"
        case "literal_error":
            return f"must be {context['expected']}"
        case "union_tag_not_found":
            return "must have a `kind`"
        case "union_tag_invalid":
            return f"must have a `kind` that is one of {context['expected_tags']}"
        case _:
            return words(problem["msg"][:1].lower() + problem["msg"][1:])
