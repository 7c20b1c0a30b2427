"""What all tables of a case file share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from valvefsi.case.overrides import nearest
from valvefsi.case.quantities import unit_of
from valvefsi.types import Unchecked

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]


def problem(message: str, key: str | None = None, value: Unchecked = None) -> PydanticCustomError:
    """Return the error of a value, or of the value under ``key`` of a table."""
    return PydanticCustomError("case", "{message}", {"message": message, "key": key, "value": value})


class Table(BaseModel):
    """A table of a case file: every key is known and documented, nothing changes after it was read."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _know_all_keys(cls, data: Unchecked) -> Unchecked:
        if isinstance(data, Mapping) and cls.model_config.get("extra") == "forbid":
            for key in data:
                if key not in cls.model_fields:
                    raise problem(f"unknown key{nearest(key, list(cls.model_fields))}", key, data[key])
        return data

    def unit(self, key: str) -> str | None:
        """Return the unit of a key, None where it holds no quantity."""
        return unit_of(type(self).model_fields[key])
