"""Functions of nothing but their arguments, asked once a process for each of them."""

import pickle
from collections.abc import Callable
from functools import wraps
from typing import Any


def asked_once(
    function: Callable[..., Any], refused: type[Exception] | tuple[()] = ()
) -> Callable[..., Any]:
    """Answer equal arguments as the first time, with the error as well if it was ``refused``."""
    answers: dict[bytes, Any] = {}

    @wraps(function)
    def answered(*arguments: Any, **options: Any) -> Any:
        asked = pickle.dumps((arguments, options))
        if asked not in answers:
            try:
                answers[asked] = function(*arguments, **options)
            except refused as error:
                answers[asked] = error
        found = answers[asked]
        if isinstance(found, Exception):
            raise found
        return found

    return answered
