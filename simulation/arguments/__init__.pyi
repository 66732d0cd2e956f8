from .checks import (
    accepted as accepted,
    arguments_at_fault as arguments_at_fault,
    check_fields as check_fields,
    checked as checked,
)
from .errors import (
    ArgumentError as ArgumentError,
    ArgumentTypeError as ArgumentTypeError,
    kind_of as kind_of,
)
from .given_arrays import (
    GivenArray as GivenArray,
    given_array as given_array,
    is_array_like as is_array_like,
    whole_array as whole_array,
)
from .models import CheckedModel as CheckedModel
from .paths import FilePath as FilePath, output_path as output_path, path_of as path_of
from .ranges import RANGES as RANGES, Range as Range
