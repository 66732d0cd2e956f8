from ._checks import (
    accepted as accepted,
    arguments_at_fault as arguments_at_fault,
    check_fields as check_fields,
    checked as checked,
    given_array as given_array,
    is_array_like as is_array_like,
    whole_array as whole_array,
)
from ._errors import (
    ArgumentError as ArgumentError,
    ArgumentTypeError as ArgumentTypeError,
    FilePath as FilePath,
    kind_of as kind_of,
    output_path as output_path,
    path_of as path_of,
)
from ._models import CheckedModel as CheckedModel
