"""Results as JSON, and files that are written whole or not at all."""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spiral.types.fields import plain


def to_json(value: Any) -> str:
    """JSON in which NaN and infinity are ``null``."""
    return json.dumps(replace_nonfinite(value), indent=1, allow_nan=False, ensure_ascii=False)


def replace_nonfinite(value: Any) -> Any:
    """Plain data with ``None`` for NaN and infinity; NumPy's numbers and arrays as Python's."""
    if isinstance(value, Mapping):
        return {str(k): replace_nonfinite(v) for k, v in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [replace_nonfinite(v) for v in value]
    if hasattr(value, "tolist"):
        return replace_nonfinite(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return plain(value) if hasattr(value, "plugin_name") else str(value)


def fill_template(template: str, **fields: str) -> str:
    """A text of ``spiral/templates`` with its ``$names`` replaced."""
    from importlib.resources import files
    from string import Template

    text = files("spiral").joinpath("templates", f"{template}.template").read_text("utf-8")
    return Template(text).substitute(fields)


def write_whole(file: Path, content: str | bytes) -> None:
    """Write to a temporary name beside the file, then move into place; text as UTF-8."""
    temporary = file.parent / f".{file.name}.{secrets.token_hex(6)}.tmp"
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)  # less the umask
    try:
        with os.fdopen(handle, "wb") as out:
            out.write(content.encode() if isinstance(content, str) else content)
            out.flush()
            os.fsync(out.fileno())
        os.replace(temporary, file)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
