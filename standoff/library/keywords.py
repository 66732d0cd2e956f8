"""Keywords that one function takes for another: told once, where that one declares them."""

import inspect
import re
from collections.abc import Callable
from typing import ParamSpec, TypeVar

_P = ParamSpec("_P")
_R = TypeVar("_R")


def with_keywords_of(
    other: Callable[..., object],
) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Give a function that takes ``**how`` the keywords of another one, beside its own.

    They stand in its signature, and in its docstring in the place of ``how``.
    """

    def decorated(function: Callable[_P, _R]) -> Callable[_P, _R]:
        signature = inspect.signature(function)
        own = [one for one in signature.parameters.values() if one.kind is not one.VAR_KEYWORD]
        theirs = [
            one
            for one in inspect.signature(other).parameters.values()
            if one.kind is one.KEYWORD_ONLY and one.name not in signature.parameters
        ]
        vars(function)["__signature__"] = signature.replace(parameters=[*own, *theirs])
        function.__annotations__ |= {one.name: one.annotation for one in theirs}
        names = ", ".join(one.name for one in theirs)
        function.__doc__ = re.sub(r"^( +)how$", rf"\1{names}", function.__doc__ or "", flags=re.M)
        return function

    return decorated
