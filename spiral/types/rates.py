"""Units of rates."""


def per_second(unit: str, times: int = 1) -> str:
    """``(m)/s`` of ``m``, ``(m)/s^2`` twice; of what has no unit, ``(1)/s``."""
    return f"({unit or '1'})/s" + (f"^{times}" if times > 1 else "")
