"""The error of an argument that cannot be; imports no library."""


class ArgumentError(ValueError):
    """An argument of a public function that cannot be, or does not go with the others.

    ``argument`` names it as Python spells it; ``reason`` is the message without that name, for
    whoever calls it otherwise.

    Examples
    --------
    >>> try:
    ...     standoff.reading("sunlight")
    ... except standoff.ArgumentError as error:
    ...     print(error)
    encoding: expected auto, linear, srgb or gamma:G such as gamma:2.2, got 'sunlight'
    """

    def __init__(self, reason: str, *, argument: str | None = None) -> None:
        super().__init__(reason)
        self.argument = argument

    @property
    def reason(self) -> str:
        """What is wrong, without the name."""
        return str(self.args[0])

    def __str__(self) -> str:
        return self.reason if self.argument is None else f"{self.argument}: {self.reason}"


class ArgumentTypeError(ArgumentError, TypeError):
    """An argument of a type that is not taken."""


def kind_of(value: object) -> str:
    """Name the type of an argument, for a message."""
    return "None" if value is None else type(value).__name__
