"""The application: command line, demo and operator console."""

__version__ = "0.1.0"

__all__ = ["__version__"]
