from typing import Annotated, Any, Literal

import pytest
from pydantic import Field

from dcf_zenoh.diagnostics import expected, type_name


@pytest.mark.parametrize(
    ("annotation", "article", "plain"),
    [
        (float, "a number", "number"),
        (int | None, "a whole number", "whole number"),
        (bool, "true or false", "true or false"),
        (Annotated[float, Field(gt=0, le=1)], "a number > 0 <= 1", "number > 0 <= 1"),
        (float | list[float], "a number or a list of numbers", "number or list of numbers"),
        (list[tuple[int, int]], "a list of lists of 2 whole numbers", "list of lists of 2 whole numbers"),
        (Literal["a", "b"], "'a' or 'b'", "'a' or 'b'"),
        (Any, "a value", "value"),
    ],
)
def test_type_is_described_in_words_of_a_fleet_file(annotation: Any, article: str, plain: str) -> None:
    assert expected(annotation) == article
    assert type_name(annotation) == plain
