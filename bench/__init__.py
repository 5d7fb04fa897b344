"""The application, which an operator runs. It may import all other packages; they do not import it."""

__version__ = "0.1.0"
