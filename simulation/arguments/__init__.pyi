from .checks import accepted as accepted, check_fields as check_fields, checked as checked
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
from .ranges import RANGES as RANGES, Range as Range
