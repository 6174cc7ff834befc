"""Packages that some methods need and the client does not."""

from __future__ import annotations

import importlib
from typing import Any


def needed(module: str, method: str, package: str) -> Any:  # noqa: ANN401
    """A module; where it is missing, an ImportError that says what to install."""
    try:
        return importlib.import_module(module)
    except ImportError as cause:
        message = f"{method} needs {package}, which is not installed: pip install {package!r}"
        raise ImportError(message, name=module) from cause
