"""Statistics of measured errors."""

from __future__ import annotations

from pydantic import Field

from mazebot.common.messages.documents.document import Document, Finite


class ErrorStatistics(Document):
    """Mean, 95th percentile and maximum of an error; null where there was nothing to measure."""

    mean: Finite | None = Field(None, description="in the unit of the error's name: m or rad")
    p95: Finite | None = Field(None, description="95th percentile, in the same unit")
    max: Finite | None = Field(None, description="in the same unit")


class TrajectoryError(Document):
    """Root mean square, 95th percentile and maximum of an error; null where none was measured."""

    rmse: Finite | None = Field(None, description="in the unit of the error's name: m or rad")
    p95: Finite | None = Field(None, description="95th percentile, in the same unit")
    max: Finite | None = Field(None, description="in the same unit")
