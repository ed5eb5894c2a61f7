"""Passwords in addresses: shown and saved as ``***``."""

from __future__ import annotations

import re

_USER = re.compile(r"(://[^/\s:@]*):[^/\s]*@")
_FIELD = re.compile(r"([?&](?:password|passwd|pwd|sslpassword|token|secret)=)[^&\s'\"#]*", re.I)


def without_passwords(text: str) -> str:
    """A text whose addresses hold no password: ``postgresql://me:***@host/db?password=***``."""
    return _FIELD.sub(r"\1***", _USER.sub(r"\1:***@", text))
