"""JSON documents of results: each is made, written and read as one pydantic model."""

from math import inf, isfinite
from typing import Annotated

from pydantic import AllowInfNan, BeforeValidator, Field, PlainSerializer

from acquisition.files import Provenance, StoredModel
from analysis.errors import ResultsFileError
from calibration.documents import write_document
from simulation.arguments import FilePath, output_path
from simulation.by_value import ByValue
from simulation.notebook import Shown

InfiniteAsNull = Annotated[
    float,
    AllowInfNan(),
    BeforeValidator(lambda value: inf if value is None else value),
    PlainSerializer(lambda value: value if isfinite(value) else None, when_used="json"),
]
"""A number that may be infinite; JSON has no infinity and stores null."""


class StoredValues(ByValue, StoredModel, allow_inf_nan=False):
    """Part of a document; fields added by later versions are ignored."""

    def __str__(self) -> str:
        return repr(self)


class ResultsDocument(Shown, StoredValues):
    """A whole document; subclasses state its schema, with a default."""

    schema_name: str = Field(alias="schema")
    provenance: Provenance | None = None

    def write(self, path: FilePath) -> None:
        """Write the document as JSON, whole or not at all; no figures or tables are written.

        Raises
        ------
        ResultsFileError
            If the file cannot be written.
        """
        write_document(output_path(path, "path", {".json"}), self, ResultsFileError)


def write_results(path: FilePath, document: ResultsDocument) -> None:
    """Write a document, whole or not at all.

    Raises
    ------
    ResultsFileError
        If the file cannot be written.
    """
    document.write(path)
