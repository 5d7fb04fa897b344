"""Limits of the results of a run, in a sequence and in a station: the run then ends with PASS or FAIL.

The decision rule is that of a certificate's statements of conformity (`bench.records.conformity`).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from sequences.solve_schema import DistortionTerm
from sequences.strict_model import StrictModel

LimitedResult = Literal["fx", "fy", "cx", "cy", "x", "y", "r", DistortionTerm]
Bound = Annotated[float, Field(ge=-1e12, le=1e12)]


class RuleConfig(StrictModel):
    """Limits of one result. The guard band is the expanded uncertainty."""

    lower: Bound | None = None
    upper: Bound | None = None

    @model_validator(mode="after")
    def _limits(self) -> RuleConfig:
        if self.lower is None and self.upper is None:
            raise PydanticCustomError("no_limit", "needs lower, upper or both.")
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise PydanticCustomError("limits", "lower must be less than upper.")
        return self


class ResultLimitConfig(RuleConfig):
    """Limits of one result of a run, in its own unit: px, mm, or none."""

    result: Annotated[LimitedResult, Field(description="Symbol of the result, such as fx.")]
    specification: Annotated[str, Field(max_length=300, description="Where the limits come from.")] = ""


ResultLimits = Annotated[tuple[ResultLimitConfig, ...], Field(max_length=100)]
